#include "chainslam/odometry/imu_alignment.hpp"

#include <benchmark/benchmark.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/core/thread_pool.hpp"

namespace chainslam {
namespace {

/// A drive of 120 s: a car that turns and brakes by turns, rolls and pitches a little. Scans at 10 Hz, IMU at `rate`
/// Hz.
struct Drive {
  std::vector<LidarPose> poses;
  std::vector<ImuSample> imu;

  explicit Drive(double rate) {
    Rng rng(1);
    const auto rotation = [](double t) {
      return SO3d::exp({0, 0, 0.8 * std::sin(0.3 * t)}) *
             SO3d::exp({0.02 * std::sin(3 * t), 0.02 * std::cos(2 * t), 0});
    };
    const auto position = [](double t) {
      return Eigen::Vector3d(10 * t + 8 * std::sin(0.4 * t), 5 * std::sin(0.5 * t), 0.05 * std::sin(4 * t));
    };
    constexpr double h = 1e-3;
    for (double t = 0; t < 120; t += 1 / rate) {
      const Eigen::Vector3d accel = (position(t + h) - 2 * position(t) + position(t - h)) / (h * h);
      imu.push_back({Timestamp::from_seconds(t + 0.05), rotation(t - h).local(rotation(t + h)) / (2 * h),
                     rotation(t).inverse() * Eigen::Vector3d(accel + Eigen::Vector3d(0, 0, 9.80665))});
    }
    for (double t = 1; t < 119; t += 0.1)
      poses.push_back({Timestamp::from_seconds(t),
                       SE3d(rotation(t).retract(Eigen::Vector3d(3e-4 * rng.normal(), 3e-4 * rng.normal(), 0)),
                            position(t) + Eigen::Vector3d(0.01 * rng.normal(), 0.01 * rng.normal(), 0))});
  }
};

/// Time for each scan, its IMU measurements and its part of the estimates included, and the longest of all.
void estimate(benchmark::State& state) {
  using Clock = std::chrono::steady_clock;
  const Drive drive(static_cast<double>(state.range(0)));
  const ThreadPool threads(static_cast<Index>(state.range(1)));
  double longest = 0;  // ms
  for (auto _ : state) {
    ImuAlignmentOptions options;
    options.rotation_deviation = std::numeric_limits<double>::infinity();
    ImuAlignment alignment(options);
    auto sample = drive.imu.begin();
    for (const LidarPose& pose : drive.poses) {
      for (; sample != drive.imu.end() && sample->time <= pose.time; ++sample) alignment.add(*sample);
      const auto start = Clock::now();
      alignment.add(pose, threads);
      longest = std::max(longest, std::chrono::duration<double, std::milli>(Clock::now() - start).count());
    }
    if (!alignment.known()) throw std::logic_error("the alignment is not known after two minutes");
  }
  state.counters["longest_ms"] = longest;
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(drive.poses.size()));
}
BENCHMARK(estimate)
    ->Name("odometry/imu_alignment/120_s")
    ->ArgNames({"hertz", "threads"})
    ->ArgsProduct({{100, 1000}, {1, 2}})
    ->UseRealTime();

}  // namespace
}  // namespace chainslam
