#pragma once

#include <Eigen/Core>
#include <variant>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/timestamp.hpp"

namespace chainslam {

/// One measurement of an IMU, in its own frame (`body`).
struct ImuSample {
  Timestamp time{};                                 ///< of the measurement
  Eigen::Vector3d gyro = Eigen::Vector3d::Zero();   ///< angular rate, rad/s
  Eigen::Vector3d accel = Eigen::Vector3d::Zero();  ///< specific force, m/s^2: +9.81 upwards at rest
  bool rate_measured = true;                        ///< false: `gyro` is no measurement, an axis of it is stuck
  bool force_measured = true;                       ///< the same of `accel`
};

/// One sweep of a LiDAR, in its own frame (`lidar`).
///
/// `cloud.time_offsets`, where present, are seconds from `time`, ascending or not, and lie within [0, end - time].
/// Where absent, the scan is a snapshot taken at `time` (already corrected for motion), and `end == time`.
struct LidarScan {
  Timestamp time{};           ///< of the first measurement, or of the snapshot
  Timestamp end{};            ///< of the last measurement
  PointCloud<float> cloud{};  ///< in the LiDAR's frame, metres
};

/// What the receiver says of its own fix.
enum class GnssQuality { none, two_dimensional, three_dimensional, differential, rtk_float, rtk_fixed };

/// One position of the GNSS antenna in WGS 84's Earth-centred frame, so that sessions with different origins compare.
struct GnssFix {
  Timestamp time{};                                               ///< of the measurement
  Eigen::Vector3d position_ecef = Eigen::Vector3d::Zero();        ///< metres
  Eigen::Matrix3d covariance_ecef = identity<Eigen::Matrix3d>();  ///< m^2
  GnssQuality quality = GnssQuality::none;                        ///< as the receiver states it
};

/// Whatever a sensor sent. A data set is a range of these in time order (a scan counts at its `end`).
using Packet = std::variant<ImuSample, LidarScan, GnssFix>;

/// What a packet holds, in the order of `Packet`'s alternatives.
enum class SensorKind { imu, lidar, gnss };

[[nodiscard]] inline SensorKind sensor_kind(const Packet& packet) { return static_cast<SensorKind>(packet.index()); }

/// When the packet was whole: a scan's end, else the time of measurement.
[[nodiscard]] inline Timestamp available_at(const Packet& packet) {
  struct Visitor {
    Timestamp operator()(const ImuSample& imu) const { return imu.time; }
    Timestamp operator()(const LidarScan& scan) const { return scan.end; }
    Timestamp operator()(const GnssFix& fix) const { return fix.time; }
  };
  return std::visit(Visitor{}, packet);
}

}  // namespace chainslam
