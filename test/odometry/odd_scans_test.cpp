#include <doctest/doctest.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "chainslam/odometry/lidar_inertial_odometry.hpp"
#include "odometry/inertial_trip.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

using Lio = LidarInertialOdometry<>;

/// There and back through the hall, at up to 6 m/s.
const InertialTrip& fast_trip() {
  static const InertialTrip trip{.pose =
                                     [](double t) {
                                       return SE3d(SO3d::exp({0, 0, 0.5 * std::sin(0.7 * t)}),
                                                   {6 * std::sin(t), 0.5 * std::sin(0.6 * t), 0.1 * std::sin(t)});
                                     },
                                 .scans = 60};
  return trip;
}

/// The trip's packets with its scans spoiled: `spoil(scan, number)`.
template <class Spoil>
std::vector<Packet> with_scans(Spoil&& spoil) {
  static const std::vector<Packet> packets = fast_trip().packets();
  std::vector<Packet> spoiled = packets;
  int number = 0;
  for (Packet& packet : spoiled)
    if (auto* scan = std::get_if<LidarScan>(&packet)) spoil(*scan, number++);
  std::ranges::stable_sort(spoiled, {}, available_at);
  return spoiled;
}

/// With `count` scans from `first` on that are stamped late.
std::vector<Packet> late(double by, int first, int count) {
  return with_scans([&](LidarScan& scan, int number) {
    if (number < first || number >= first + count) return;
    scan.time = scan.time + seconds(by);
    scan.end = scan.end + seconds(by);
  });
}

/// With one scan that seems to be taken elsewhere.
std::vector<Packet> moved(const SE3d& T, int which) {
  return with_scans([&](LidarScan& scan, int number) {
    if (number != which) return;
    for (Eigen::Vector3f& p : scan.cloud.positions) p = (T * p.cast<double>()).cast<float>();
  });
}

struct Result {
  double worst = 0;                                  ///< metres, from some frame on
  std::int64_t odd = 0, lost = 0, imu_left_out = 0;  ///< frames
};
/// @param clock  seconds that the scans are late by in the end.
Result follow(const std::vector<Packet>& packets, std::size_t from, const Lio::Options& options = {},
              double clock = 0) {
  Lio odometry(options);
  const TripOutcome run = follow_trip(fast_trip(), packets, odometry);
  Result result{.odd = odometry.counts().odd_scans, .lost = odometry.counts().lost_scans};
  for (std::size_t i = 1; i < run.frames.size(); ++i) {
    const Frame& frame = run.frames[i];
    if (frame.health.imu_use != ImuUse::all) ++result.imu_left_out;
    if (i < from) continue;
    const SE3d truth = fast_trip().truth(frame.time - seconds(clock));
    const SE3d error = truth.inverse() * run.T_world_odom * frame.T_odom_body;
    result.worst = std::max(result.worst, error.translation().norm());
  }
  return result;
}

}  // namespace

TEST_SUITE("odometry/odd_scans") {
  TEST_CASE("scans whose time is wrong are followed by scans that lie where they should") {
    for (const double by : {0.04, 0.06, -0.04, -0.08})
      for (const int first : {28, 34})
        for (const int count : {1, 2}) {
          CAPTURE(by);
          CAPTURE(first);
          CAPTURE(count);
          const Result run = follow(late(by, first, count), static_cast<std::size_t>(first + count + 1));
          CHECK(run.worst < 0.02);
          CHECK(run.odd > 0);
          CHECK(run.imu_left_out <= 2);
          CHECK(run.lost == 0);
        }
  }

  TEST_CASE("a scan that lies elsewhere") {
    for (const SE3d& T :
         {SE3d(SO3d(), {0, 0.3, 0}), SE3d(SO3d(), {0.8, 0, 0}), SE3d(SO3d::exp({0, 0, 0.02}), {0, 0.8, 0})}) {
      CAPTURE(T.log().transpose());
      const Result run = follow(moved(T, 30), 32);
      CHECK(run.worst < 0.02);
      CHECK(run.imu_left_out == 0);
    }
  }

  TEST_CASE("the scans' clock jumps: what follows is consistent") {
    for (const double by : {0.05, -0.08}) {
      CAPTURE(by);
      const Result run = follow(late(by, 30, 60), 40, {}, by);
      CHECK(run.worst < 0.25);  // the IMU's readings come at the wrong time from then on
      CHECK(run.lost == 0);
    }
  }

  // An accelerometer that fails is found to, though scans are blamed at first.
  TEST_CASE("an accelerometer that jumps is left out within a few scans") {
    std::vector<Packet> packets = fast_trip().packets();
    for (Packet& packet : packets)
      if (auto* sample = std::get_if<ImuSample>(&packet))
        if (sample->time.to_seconds() > 13) sample->accel[0] += 30;
    const Result run = follow(packets, 30);
    CHECK(run.worst < 0.5);
    CHECK(run.odd <= 5);
    CHECK(run.imu_left_out > 20);
  }

  TEST_CASE("each setting matters") {
    const auto worst = [](auto&& change) {
      Lio::Options options;
      change(options);
      double most = 0;
      for (const auto& packets : {late(0.08, 28, 2), late(-0.08, 28, 1), late(0.05, 40, 1)})
        most = std::max(most, follow(packets, 43, options).worst);
      return most;
    };
    CHECK(worst([](Lio::Options&) {}) < 0.05);
    CHECK(worst([](Lio::Options& options) { options.monitor.max_odd_scans = 0; }) > 0.3);
    CHECK(worst([](Lio::Options& options) { options.monitor.odd_distance = 0.5; }) > 0.3);
    CHECK(worst([](Lio::Options& options) { options.motion.odd_position = 0.05; }) > 0.3);
  }
}
