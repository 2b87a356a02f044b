#pragma once

#include <vector>

#include "chainslam/sensor/packet.hpp"
#include "generated/hall.hpp"

namespace generated {

/// The drive: 1 s at rest, 2 s of acceleration, then 1 m/s, on a circle of 5 m radius about the hall's centre.
inline double turn_rate(double t) { return std::clamp(0.1 * (t - 1), 0.0, 0.2); }  // rad/s
inline double turned(double t) { return t < 1 ? 0 : t < 3 ? 0.05 * (t - 1) * (t - 1) : 0.2 * (t - 2); }

/// Where the body is at time t, seconds.
inline SE3d T_hall_body(double t) {
  return upright(5 * std::cos(turned(t)), 5 * std::sin(turned(t)), turned(t) + std::numbers::pi / 2);
}

/// What an IMU of 100 Hz and a LiDAR of 10 Hz, whose frame is the body's, measure there for 8 s.
inline std::vector<Packet> circle_drive() {
  std::vector<Packet> packets;
  Rng rng(1);
  const auto noise = [&](double sigma) -> Eigen::Vector3d {
    return {rng.normal(0, sigma), rng.normal(0, sigma), rng.normal(0, sigma)};
  };
  for (int i = 0; i < 820; ++i) {
    const Timestamp time = Timestamp::from_seconds(0.01 * i);
    const double rate = turn_rate(0.01 * i), gain = i >= 100 && i < 300 ? 0.5 : 0.0;  // m/s^2, forward
    packets.push_back(ImuSample{.time = time,
                                .gyro = Eigen::Vector3d(0, 0, rate) + noise(0.002),
                                .accel = Eigen::Vector3d(gain, 5 * rate * rate, 9.81) + noise(0.02)});
    if (i % 10 != 0 || i >= 800) continue;
    PointCloud<float> cloud = sweep([&](double offset) { return T_hall_body(0.01 * i + offset); }, 0.1, rng);
    const Timestamp end = time + seconds(cloud.time_offsets.back());
    packets.push_back(LidarScan{.time = time, .end = end, .cloud = std::move(cloud)});
  }
  return packets;
}

}  // namespace generated
