#pragma once

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>
#include <variant>

#include "chainslam/core/executor.hpp"
#include "chainslam/odometry/imu_alignment.hpp"
#include "chainslam/odometry/imu_process.hpp"
#include "chainslam/sensor/frame.hpp"
#include "chainslam/sensor/imu_check.hpp"
#include "chainslam/sensor/packet.hpp"

namespace chainslam {

/// Odometry that finds out by how much its IMU's clock and axes differ from what is given, and corrects them.
///
/// `ImuAlignment` compares the IMU with the poses of the scans themselves. A time offset is corrected as soon as it is
/// significant, axes only where the data exclude the given rotation: what is less than that the filter itself
/// estimates.
///
/// @tparam Odometry  such as `LidarInertialOdometry<>`: with `correct_imu`, `imu_correction`, `T_map_lidar`, `state`,
///                   `scan_time_deviation` and `mounting_evidence`.
template <class Odometry>
class SelfCalibrating {
 public:
  using Options = typename Odometry::Options;  ///< of the odometry

  /// Starts without knowledge of the calibration.
  explicit SelfCalibrating(Options options = {}, ImuAlignmentOptions alignment = {})
      : T_body_lidar_(options.T_body_lidar),
        imu_check_(options.imu_check),
        odometry_(std::move(options)),
        alignment_(with(alignment, T_body_lidar_)) {}

  /// As the odometry's own.
  template <Executor E = Serial>
  std::optional<Frame> process(const Packet& packet, const E& executor = {}) {
    if (const auto* sample = std::get_if<ImuSample>(&packet))
      imu_check_.add(*sample, [&](const ImuSample& checked) {
        if (checked.rate_measured && checked.force_measured) alignment_.add(checked);
      });
    return followed(odometry_.process(packet, executor), executor);
  }
  /// See the odometry's.
  template <Executor E = Serial>
  std::optional<Frame> flush(const E& executor = {}) {
    return followed(odometry_.flush(executor), executor);
  }

  [[nodiscard]] const Odometry& odometry() const { return odometry_; }  ///< the odometry that is calibrated
  /// What is known of clock and axes as the IMU gives them. Once the IMU is corrected and used, its rotation to the
  /// LiDAR is the filter's, which uses each point, as far as the filter has seen it move.
  [[nodiscard]] ImuAlignmentEstimate alignment() const {
    const ImuAlignmentEstimate& found = alignment_.estimate();
    const SO3d& R_body_imu = odometry_.imu_correction().R_body_imu;
    const bool corrected = !found.contradicted || R_body_imu.log().norm() > 0;
    if (!corrected || found.time_offset_deviation >= max_clock_deviation) return found;
    RotationEvidence evidence = odometry_.mounting_evidence();
    evidence.about = R_body_imu.inverse() * evidence.about;
    return alignment_.with(evidence);
  }
  [[nodiscard]] auto counts() const { return odometry_.counts(); }  ///< counts of the odometry

 private:
  static constexpr double max_clock_deviation = 0.02;  ///< seconds, of an offset that is acted on

  [[nodiscard]] static ImuAlignmentOptions with(ImuAlignmentOptions options, const SE3d& T_body_lidar) {
    options.T_body_lidar = T_body_lidar;
    return options;
  }

  template <Executor E>
  std::optional<Frame> followed(std::optional<Frame> frame, const E& executor) {
    if (!frame || frame->health.status != FrameStatus::good) return frame;
    constexpr double angle = 5e-4, distance = 0.02;  // rad, m: what registration leaves
    // How far times are off is known by the IMU alone.
    const double time_deviation = frame->health.imu_use == ImuUse::all ? odometry_.scan_time_deviation() : 0.0;
    const LidarPose pose{frame->time, odometry_.T_map_lidar(), angle, distance, time_deviation};
    if (alignment_.add(pose, executor)) correct();
    return frame;
  }

  /// Whether to correct the clock (again). How scans were undistorted biases the offset by some milliseconds: a clock
  /// that is right to that is left alone.
  [[nodiscard]] bool clock_is_off(double corrected) const {
    constexpr double bias = 0.01, min_change = 0.002;  // seconds
    const double deviation = alignment_.estimate().time_offset_deviation;
    const double off = std::abs(alignment_.estimate().time_offset - corrected);
    return deviation < max_clock_deviation && off > (corrected == 0 ? bias + 2 * deviation : min_change);
  }

  void correct() {
    constexpr double min_turn = 2e-3, max_axes_deviation = 0.04;  // rad
    constexpr double min_axes_time = 3;  // seconds: of less, deviations say little, and scans alone do meanwhile
    const ImuAlignmentEstimate& found = alignment_.estimate();
    ImuCorrection correction = odometry_.imu_correction();
    const SO3d axes = T_body_lidar_.rotation() * found.R_body_lidar.inverse();
    const double axes_deviation = std::sqrt(found.rotation_covariance.trace());
    const bool axes_known = axes_deviation < max_axes_deviation && found.seconds_used >= min_axes_time;
    // A clock fitted to wrong axes is as wrong, and would not make these measurements usable.
    if (found.contradicted && !axes_known) return;
    const bool new_clock = clock_is_off(correction.time_offset);
    // The filter has gone on from the axes applied: what it has found since need not be found again.
    const SO3d R_body_lidar = correction.R_body_imu.inverse() * T_body_lidar(odometry_.state()).rotation();
    const bool new_axes =
        found.contradicted && R_body_lidar.local(found.R_body_lidar).norm() > std::max(min_turn, axes_deviation);
    if (!new_clock && !new_axes) return;
    if (new_clock) correction.time_offset = found.time_offset;
    if (new_axes) correction.R_body_imu = axes;
    const bool up_known = found.up_odom.norm() > 0;
    odometry_.correct_imu(correction, up_known ? std::optional<Eigen::Vector3d>(found.up_odom) : std::nullopt,
                          axes_deviation / std::sqrt(3.0));
  }

  SE3d T_body_lidar_;
  ImuCheck imu_check_;  ///< as the odometry's own: what is rejected must not calibrate, either
  Odometry odometry_;
  ImuAlignment alignment_;
};

}  // namespace chainslam
