#pragma once

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/sensor/packet.hpp"

namespace chainslam {

/// What of an IMU's measurements an estimate relies on, from most to least. The numbers are those of map files.
enum class ImuUse : std::uint8_t {
  all = 0,
  gyroscope = 1,        ///< the scans contradicted the accelerometer
  rough_gyroscope = 2,  ///< the scans contradicted the gyroscope, too: it only undistorts
  none = 3,             ///< not used, or there are no measurements
};

/// How well odometry held on to one scan.
enum class FrameStatus { good, degenerate, lost };

/// How far a frame's pose can be relied on.
struct FrameHealth {
  FrameStatus status = FrameStatus::good;  ///< how well the scan was registered
  Index points = 0;                        ///< given to registration
  Index matches = 0;                       ///< that found a partner
  double residual_rms = 0;                 ///< metres, over matches
  Index iterations = 0;                    ///< of registration
  bool map_restarted = false;  ///< the local map was cleared, and begins with this scan at the predicted pose
  bool after_gap = false;      ///< no frame before for longer than the motion can be predicted
  /// What of the IMU the pose relies on; empty if odometry does not say.
  std::optional<ImuUse> imu_use{};
  bool imu_as_set = false;  ///< settings leave the accelerometer out: `ImuUse::gyroscope` is then no contradiction

  /// Whether the pose may be wrong by more than registration to the local map leaves.
  [[nodiscard]] bool doubtful() const {
    const bool imu_contradicted = (imu_use == ImuUse::gyroscope && !imu_as_set) || imu_use == ImuUse::rough_gyroscope;
    return status != FrameStatus::good || map_restarted || after_gap || imu_contradicted;
  }
};

/// What odometry says of one scan.
struct Frame {
  Timestamp time;                              ///< the pose holds at this time
  SE3d T_odom_body;                            ///< pose at `time`
  Matrix6d covariance = identity<Matrix6d>();  ///< of T_odom_body, tangent [translation; rotation]
  PointCloud<float> cloud;                     ///< motion-corrected to `time`, body frame
  FrameHealth health;                          ///< how far it can be relied on
  std::optional<GnssFix> gnss{};               ///< at `time`, if it came with a recorded frame
  /// Integral of the specific force since the frame before, m/s, body frame at `time`: what the accelerometer measured,
  /// gravity and bias included. Empty if not all of it was measured, or odometry excludes the accelerometer.
  std::optional<Eigen::Vector3d> delta_velocity{};
};

/// The covariance of a pose: its upper triangle, row by row, rounded to floats. One that is not finite, or not as
/// floats, becomes that of a pose of which nothing is known.
class PackedCovariance {
 public:
  static constexpr std::size_t entries = 21;  ///< numbers in an upper triangle

  PackedCovariance() = default;
  /// From its upper triangle, row by row.
  explicit PackedCovariance(const std::array<float, entries>& upper) : upper_(upper) {}
  /// Rounds the upper triangle to float.
  explicit PackedCovariance(const Matrix6d& covariance) {
    constexpr double unknown = 1e30;  // m^2 and rad^2
    bool known = true;
    for (int k = 0; k < 36; ++k) known &= is_finite(covariance.data()[k]) && std::abs(covariance.data()[k]) <= unknown;
    std::size_t k = 0;
    for (int i = 0; i < 6; ++i)
      for (int j = i; j < 6; ++j) upper_[k++] = static_cast<float>(known ? covariance(i, j) : i == j ? unknown : 0.0);
  }

  /// The symmetric matrix.
  [[nodiscard]] Matrix6d matrix() const {
    Matrix6d covariance;
    std::size_t k = 0;
    for (int i = 0; i < 6; ++i)
      for (int j = i; j < 6; ++j) covariance(i, j) = covariance(j, i) = static_cast<double>(upper_[k++]);
    return covariance;
  }
  [[nodiscard]] const std::array<float, entries>& upper() const { return upper_; }  ///< the upper triangle, row by row
  /// Whether all members are equal.
  friend bool operator==(const PackedCovariance&, const PackedCovariance&) = default;

 private:
  std::array<float, entries> upper_{};
};

/// What a map keeps of each frame of odometry, also of those that are no keyframes: where it was, and how well that is
/// known.
struct FrameRecord {
  SessionId session{};            ///< the session of the frame
  Timestamp time{};               ///< of the pose
  SE3d T_odom_body{};             ///< as odometry gave it
  PackedCovariance covariance{};  ///< of T_odom_body, tangent [translation; rotation], metres and radians
  FrameHealth health{};           ///< as odometry gave it
  std::optional<Eigen::Vector3f> delta_velocity{};  ///< see `Frame::delta_velocity`
};

/// @returns the record of a frame; its session is given by the map that takes it.
[[nodiscard]] inline FrameRecord record_of(const Frame& frame) {
  FrameRecord record{{}, frame.time, frame.T_odom_body, PackedCovariance(frame.covariance), frame.health, {}};
  if (frame.delta_velocity) record.delta_velocity = frame.delta_velocity->cast<float>();
  return record;
}

}  // namespace chainslam
