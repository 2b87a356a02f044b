#pragma once

#include <optional>
#include <string>
#include <vector>

#include "chainslam/lie/se3.hpp"
#include "chainslam/odometry/imu_alignment.hpp"

namespace chainslam::support {

/// How an IMU's clock and axes were given, what a session's data say of them, and what its odometry used at the end.
struct ImuCalibration {
  SE3d T_body_lidar;               ///< given
  bool extrinsic_given = true;     ///< false: nothing states it, and `T_body_lidar` is the identity
  double time_offset = 0;          ///< seconds, given: the setting imu.time_offset, added to stamps before all else
  ImuAlignmentEstimate found;      ///< of samples as read, with that offset
  ImuCorrection applied;           ///< likewise
  double scan_time_deviation = 0;  ///< seconds that times of scans are off, by the odometry; 0: taken as exact
  std::optional<double> clock_corrected, axes_corrected;  ///< seconds since the first frame, of the last large change

  /// What the setting imu.time_offset should be, by the data, and as applied.
  [[nodiscard]] double found_time_offset() const { return time_offset - found.time_offset; }
  [[nodiscard]] double applied_time_offset() const { return time_offset - applied.time_offset; }
  /// The setting dataset.T_body_lidar that has the effect of what was applied.
  [[nodiscard]] SE3d applied_T_body_lidar() const;

  /// Takes the correction that odometry applies at `time`, seconds since its first frame.
  void follow(const ImuCorrection& correction, double time);
};

/// Standard deviation of a rotation about its worst axis, rad.
[[nodiscard]] double rotation_deviation(const ImuAlignmentEstimate& found);

/// Roll, pitch and yaw in degrees, R = Rz(yaw) Ry(pitch) Rx(roll), as dataset.T_body_lidar takes them.
[[nodiscard]] Eigen::Vector3d roll_pitch_yaw_deg(const SO3d& R);

/// The offset by the data: "-0.067 s (+- 0.003)", or that the motion does not show it.
[[nodiscard]] std::string time_offset_text(const ImuCalibration& calibration);
/// By how much the times of scans are off: "15.2 ms (standard deviation)", or that they are taken as exact.
[[nodiscard]] std::string scan_times_text(const ImuCalibration& calibration);
/// R_body_lidar by the data: "roll 0.1, pitch -0.2, yaw 90.1 deg (+- 0.3)", or which of it the motion does not show.
[[nodiscard]] std::string rotation_text(const ImuCalibration& calibration);

/// What a user should know: what was given and is wrong, since when it was corrected, and what to set. Empty if what
/// was given is right, as far as the data show it.
[[nodiscard]] std::vector<std::string> calibration_notes(const ImuCalibration& calibration);

/// The same before anything is corrected: where the data contradict what was given, and what to set.
[[nodiscard]] std::vector<std::string> contradictions(const ImuCalibration& calibration);

}  // namespace chainslam::support
