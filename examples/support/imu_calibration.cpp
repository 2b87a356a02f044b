#include "support/imu_calibration.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>

#include "chainslam/core/symmetric_eigen.hpp"

namespace chainslam::support {
namespace {

constexpr double degrees = 180 / std::numbers::pi;
constexpr double clear_offset = 0.02, clear_angle = 0.04;  // seconds, rad, deviations: good enough to be acted on
constexpr double large_offset = 0.01, large_angle = 1 / degrees;  // seconds, rad: less is the scans' own

template <class... Values>
std::string text_of(const char* format, Values... values) {
  char text[256];
  std::snprintf(text, sizeof text, format, values...);
  return text;
}

/// Without the sign of a zero.
double rounded(double value, double step) { return std::round(value / step) * step + 0.0; }

/// The pose in axes that R turns the body's to.
SE3d turned(const SE3d& T_body_lidar, const SO3d& R) { return SE3d(R, Eigen::Vector3d::Zero()) * T_body_lidar; }

/// As the setting dataset.T_body_lidar takes it.
std::string pose_setting(const SE3d& pose) {
  const Eigen::Vector3d& t = pose.translation();
  const Eigen::Quaterniond q = pose.rotation().quaternion();
  return text_of("[%.3f, %.3f, %.3f, %.5f, %.5f, %.5f, %.5f]", t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w());
}

std::string corrected(const std::optional<double>& time) {
  return time ? text_of(": corrected from %.1f s on; ", *time) : ": corrected; ";
}

std::string clock_finding(const ImuCalibration& calibration) {
  const double given = calibration.time_offset, late = calibration.found.time_offset;
  return (given != 0 ? text_of("with imu.time_offset = %.3f, IMU stamps are still", given) : "IMU stamps are") +
         text_of(" %.0f ms %s (+- %.0f)", std::abs(1e3 * late), late > 0 ? "late" : "early",
                 std::max(1.0, 1e3 * calibration.found.time_offset_deviation));
}

std::string clock_setting(const ImuCalibration& calibration) {
  return text_of("set imu.time_offset = %.3f to start with the right one", calibration.found_time_offset());
}

std::string against(const ImuCalibration& calibration) {
  return calibration.extrinsic_given ? "against the given T_body_lidar"
                                     : "against the LiDAR's (no T_body_lidar is given)";
}

/// By all of the data; as applied, should they not show it.
SO3d R_body_imu(const ImuCalibration& calibration) {
  if (!calibration.found.contradicted && !calibration.found.rotation_known) return calibration.applied.R_body_imu;
  return calibration.T_body_lidar.rotation() * calibration.found.R_body_lidar.inverse();
}

std::string axes_finding(const ImuCalibration& calibration) {
  const Eigen::Vector3d turn = R_body_imu(calibration).log(), axis = turn / turn.norm();
  return text_of("the IMU's axes are turned by %.1f deg (+- %.1f) about (%.2f %.2f %.2f) ", turn.norm() * degrees,
                 degrees * rotation_deviation(calibration.found), axis.x(), axis.y(), axis.z()) +
         against(calibration);
}

/// A correction that later data do not bear out.
std::string axes_withdrawn(const ImuCalibration& calibration) {
  return text_of("the IMU's axes were taken to be turned by %.1f deg",
                 degrees * calibration.applied.R_body_imu.log().norm()) +
         corrected(calibration.axes_corrected) +
         text_of("by all of the data T_body_lidar is right to %.1f deg (+- %.1f)",
                 degrees * R_body_imu(calibration).log().norm(), degrees * rotation_deviation(calibration.found));
}

std::string axes_setting(const ImuCalibration& calibration) {
  return "set dataset.T_body_lidar = " +
         pose_setting(turned(calibration.T_body_lidar, R_body_imu(calibration).inverse())) +
         " to start with the right one";
}

/// A contradiction that does not say what is right.
std::string unclear_axes(const ImuCalibration& calibration) {
  return "the IMU's axes are turned by at least " +
         text_of("%.1f deg ", degrees * calibration.found.contradiction_angle) + against(calibration) +
         ": the motion does not show all of them; set dataset.T_body_lidar to the extrinsic calibration, or rotate "
         "about more axes";
}

}  // namespace

SE3d ImuCalibration::applied_T_body_lidar() const { return turned(T_body_lidar, applied.R_body_imu.inverse()); }

void ImuCalibration::follow(const ImuCorrection& correction, double time) {
  const ImuCorrection change = correction.since(applied);
  if (std::abs(change.time_offset) >= large_offset) clock_corrected = time;
  if (change.R_body_imu.log().norm() >= large_angle) axes_corrected = time;
  applied = correction;
}

double rotation_deviation(const ImuAlignmentEstimate& found) {
  const auto variances = jacobi_eigen(found.rotation_covariance).values;
  return std::sqrt(std::max({variances[0], variances[1], variances[2]}));
}

Eigen::Vector3d roll_pitch_yaw_deg(const SO3d& R) {
  const Eigen::Matrix3d m = R.matrix();
  return degrees * Eigen::Vector3d(std::atan2(m(2, 1), m(2, 2)), std::asin(std::clamp(-m(2, 0), -1.0, 1.0)),
                                   std::atan2(m(1, 0), m(0, 0)));
}

std::string time_offset_text(const ImuCalibration& calibration) {
  const ImuAlignmentEstimate& found = calibration.found;
  if (found.seconds_used == 0) return "the motion does not show it";
  return text_of("%.3f s (+- %.3f)%s", rounded(calibration.found_time_offset(), 1e-3), found.time_offset_deviation,
                 found.time_known ? "" : ", not well shown by the motion");
}

std::string scan_times_text(const ImuCalibration& calibration) {
  if (calibration.scan_time_deviation == 0) return "taken as exact";
  return text_of("off by %.1f ms (standard deviation)", 1e3 * calibration.scan_time_deviation);
}

std::string rotation_text(const ImuCalibration& calibration) {
  const ImuAlignmentEstimate& found = calibration.found;
  if (found.seconds_used == 0) return "the motion does not show it";
  const Eigen::Vector3d angles = roll_pitch_yaw_deg(found.R_body_lidar);
  return text_of("roll %.1f, pitch %.1f, yaw %.1f deg (+- %.1f)", rounded(angles.x(), 0.1), rounded(angles.y(), 0.1),
                 rounded(angles.z(), 0.1), degrees * rotation_deviation(found)) +
         (found.rotation_known ? "" : text_of(", %d of 3 axes well shown by the motion", found.observed_rotation_axes));
}

std::vector<std::string> calibration_notes(const ImuCalibration& calibration) {
  std::vector<std::string> notes;
  if (std::abs(calibration.applied.time_offset) >= large_offset)
    notes.push_back(clock_finding(calibration) + corrected(calibration.clock_corrected) + clock_setting(calibration));
  const bool was_corrected = calibration.applied.R_body_imu.log().norm() >= large_angle;
  if (was_corrected && R_body_imu(calibration).log().norm() < large_angle)
    notes.push_back(axes_withdrawn(calibration));
  else if (was_corrected)
    notes.push_back(axes_finding(calibration) + corrected(calibration.axes_corrected) + axes_setting(calibration));
  else if (calibration.found.contradicted)
    notes.push_back(unclear_axes(calibration));
  return notes;
}

std::vector<std::string> contradictions(const ImuCalibration& calibration) {
  std::vector<std::string> findings;
  const ImuAlignmentEstimate& found = calibration.found;
  const double deviation = found.time_offset_deviation;
  if (deviation < clear_offset && std::abs(found.time_offset) >= std::max(large_offset, 3 * deviation))
    findings.push_back(clock_finding(calibration) + ": " + clock_setting(calibration));
  if (!found.contradicted) return findings;
  const bool clear = rotation_deviation(found) < clear_angle;
  findings.push_back(clear ? axes_finding(calibration) + ": " + axes_setting(calibration) : unclear_axes(calibration));
  return findings;
}

}  // namespace chainslam::support
