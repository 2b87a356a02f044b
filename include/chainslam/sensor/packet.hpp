#pragma once

#include <variant>

#include "chainslam/sensor/gnss_fix.hpp"
#include "chainslam/sensor/imu_sample.hpp"
#include "chainslam/sensor/lidar_scan.hpp"

namespace chainslam {

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
