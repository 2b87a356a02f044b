#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/random.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sensor/frame.hpp"
#include "chainslam/sensor/packet.hpp"
#include "support/world.hpp"

namespace chainslam::test {

/// A body that carries a LiDAR and an inertial unit along a smooth path through a world.
struct InertialTrip {
  World world = hall();
  SE3d (*pose)(double) = nullptr;  ///< T_world_body at seconds from the start
  SE3d T_body_lidar{};
  int scans = 50;
  double imu_rate = 100;  ///< Hz; 0: no inertial unit
  double imu_lead = 1;    ///< seconds of readings before the first scan
  Eigen::Vector3d gyro_bias{0.004, -0.003, 0.002}, accel_bias{0.05, -0.04, 0.03};
  double gyro_noise = 1e-3, accel_noise = 2e-2;  ///< of a sample
  double clock_jitter = 0;                       ///< seconds, deviation of a scan's true time from the stated
  Spinner spinner{.rings = 32, .columns = 180};

  /// What the unit feels at a time, without errors.
  [[nodiscard]] ImuSample felt(double t) const {
    constexpr double h = 1e-3;
    const SE3d before = pose(t - h), now = pose(t), after = pose(t + h);
    const Eigen::Vector3d acceleration = (after.translation() - 2 * now.translation() + before.translation()) / (h * h);
    return {.time = Timestamp::from_seconds(t),
            .gyro = before.rotation().local(after.rotation()) / (2 * h),
            .accel = now.rotation().inverse() * Eigen::Vector3d(acceleration + 9.81 * Eigen::Vector3d::UnitZ())};
  }

  /// All packets in time order; scans begin at multiples of their duration.
  [[nodiscard]] std::vector<Packet> packets() const {
    Rng rng(21);
    const auto noise = [&](double deviation) {
      return Eigen::Vector3d(rng.normal(0, deviation), rng.normal(0, deviation), rng.normal(0, deviation));
    };
    std::vector<Packet> all;
    const double end = scans * spinner.duration + 0.05;
    for (int i = 0; imu_rate > 0 && i / imu_rate - imu_lead < end; ++i) {
      ImuSample sample = felt(i / imu_rate - imu_lead);
      sample.time = Timestamp::from_seconds(10 + i / imu_rate - imu_lead);
      sample.gyro += gyro_bias + noise(gyro_noise);
      sample.accel += accel_bias + noise(accel_noise);
      all.emplace_back(sample);
    }
    Rng clock(22);
    for (int i = 0; i < scans; ++i) {
      const double off = clock.normal(0, clock_jitter);
      LidarScan scan = spinner.sweep(
          world, i * spinner.duration, [&](double t) { return pose(t + off) * T_body_lidar; }, rng);
      scan.time = scan.time + seconds(10);
      scan.end = scan.end + seconds(10);
      all.emplace_back(std::move(scan));
    }
    std::ranges::stable_sort(all, {}, available_at);
    return all;
  }

  [[nodiscard]] SE3d truth(Timestamp time) const { return pose(time.to_seconds() - 10); }
};

/// How a trip was followed.
struct TripOutcome {
  std::vector<Frame> frames;
  SE3d T_world_odom;      ///< the truth at the first frame
  double max_error = 0;   ///< metres, of all frames
  double max_angle = 0;   ///< radians
  double last_error = 0;  ///< metres
  double tilt = 0;        ///< at the first frame
  bool finite = true;
};

template <class Odometry, class Executor = Serial>
TripOutcome follow_trip(const InertialTrip& trip, const std::vector<Packet>& packets, Odometry& odometry,
                        const Executor& executor = {}) {
  TripOutcome outcome;
  const auto take = [&](Frame frame) {
    const SE3d truth = trip.truth(frame.time);
    if (outcome.frames.empty()) {
      outcome.T_world_odom = truth * frame.T_odom_body.inverse();
      outcome.tilt = std::acos(std::min(1.0, (outcome.T_world_odom.rotation() * Eigen::Vector3d::UnitZ()).z()));
    }
    const Vector6d error = truth.local(outcome.T_world_odom * frame.T_odom_body);
    outcome.last_error = error.head<3>().norm();
    outcome.max_error = std::max(outcome.max_error, outcome.last_error);
    outcome.max_angle = std::max(outcome.max_angle, error.tail<3>().norm());
    outcome.finite = outcome.finite && is_finite(error) && is_finite(frame.covariance);
    outcome.frames.push_back(std::move(frame));
  };
  for (const Packet& packet : packets)
    if (auto frame = odometry.process(packet, executor)) take(std::move(*frame));
  if constexpr (requires { odometry.flush(executor); })
    while (auto frame = odometry.flush(executor)) take(std::move(*frame));
  return outcome;
}

}  // namespace chainslam::test
