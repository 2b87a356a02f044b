#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include "chainslam/odometry/lidar_inertial_odometry.hpp"
#include "chainslam/odometry/lidar_odometry.hpp"
#include "chainslam/trajectory/trajectory.hpp"
#include "odometry/shared_drives.hpp"
#include "support/quick.hpp"
#include "support/real_drives.hpp"

using namespace chainslam;

namespace {

/// Moves the points of `count` scans from `first` on away from all that the local map holds: nothing fits them.
test::Drive without_view(test::Drive drive, std::size_t first, std::size_t count) {
  for (std::size_t i = first; i < first + count; ++i)
    for (Eigen::Vector3f& p : drive.scans[i].cloud.positions) p += Eigen::Vector3f(0, 0, 35);
  return drive;
}

template <class Odometry>
std::vector<Frame> frames_of(const test::Drive& drive) {
  typename Odometry::Options options;
  options.T_body_lidar = drive.T_body_lidar;
  Odometry odometry(options);
  std::vector<Frame> frames;
  const auto take = [&](std::optional<Frame> frame) {
    if (!frame) return;
    frame->cloud = {};
    frames.push_back(std::move(*frame));
  };
  auto sample = drive.imu.begin();
  for (const LidarScan& scan : drive.scans) {
    for (; sample != drive.imu.end() && sample->time <= scan.end; ++sample) take(odometry.process(Packet(*sample)));
    take(odometry.process(Packet(scan)));
  }
  if constexpr (requires { odometry.flush(); })
    while (auto frame = odometry.flush()) take(std::move(frame));
  return frames;
}

/// How far the body's position is off, in metres and in standard deviations of all three axes, seen from a frame
/// before.
struct Error {
  double metres = 0, deviations = 0;
};
Error error_since(const Frame& before, const Frame& frame, const test::Drive& drive) {
  const auto truth = [&](const Frame& of) {
    return pose_at(drive.reference, of.time, seconds(1)).value() * drive.T_body_lidar.inverse();
  };
  const SE3d moved = before.T_odom_body.inverse() * frame.T_odom_body, should = truth(before).inverse() * truth(frame);
  const double off = (moved.translation() - should.translation()).norm();
  return {off, off / std::sqrt(frame.covariance(0, 0) + frame.covariance(1, 1) + frame.covariance(2, 2))};
}

/// Loses scans at several places of a drive, and checks what the frames say of themselves.
template <class Odometry>
void lose_scans(const test::Drive& drive, std::size_t count, bool restarts) {
  for (const std::size_t first : {20U, 55U}) {
    if (first == 55 && !test::full()) break;
    test::Drive part = without_view(drive, first, count);
    part.scans.resize(first + count + 1);
    const std::vector<Frame> frames = frames_of<Odometry>(part);
    REQUIRE(frames.size() == part.scans.size());
    double largest = 0, last_variance = 0, most_deviations = 0;
    for (std::size_t i = first; i < first + count && frames[i].health.status == FrameStatus::lost; ++i) {
      const Error error = error_since(frames[first - 1], frames[i], drive);
      largest = std::max(largest, error.metres);
      most_deviations = std::max(most_deviations, error.deviations);
      CHECK(frames[i].covariance(0, 0) > last_variance);
      last_variance = frames[i].covariance(0, 0);
    }
    CHECK(frames[first].health.status == FrameStatus::lost);
    CHECK(most_deviations < 3);
    const auto restarted = [](const Frame& frame) { return frame.health.map_restarted; };
    CHECK(std::ranges::any_of(frames, restarted) == restarts);
    const Frame& after = frames[first + count - (restarts ? 1 : 0)];  // what restarted the map still fits it
    const Error error = error_since(frames[first - 1], after, drive);
    MESSAGE(count, " scans from ", first, " on: predicted within ", largest, " m, ", most_deviations,
            " deviations; then off by ", error.metres, " m, said ", std::sqrt(after.covariance(0, 0)), " m");
    CHECK(after.health.status == FrameStatus::good);
    if (restarts)
      CHECK(error.deviations < 3);
    else
      CHECK(error.metres < 0.3);  // found again
  }
}

}  // namespace

TEST_SUITE("odometry/lost_scans") {
  TEST_CASE("KITTI 00 with scans that nothing fits: covariances hold while they are lost and after the map restarts" *
            doctest::skip(test::quick())) {
    const auto& drive = test::first101();
    if (!drive) return;
    const test::Drive without_imu = test::without_imu(*drive);
    for (const std::size_t count : {8U, 4U, 1U}) {
      if (count < 8 && !test::full()) break;
      lose_scans<LidarOdometry<>>(without_imu, count, false);
      lose_scans<LidarInertialOdometry<>>(*drive, count, false);
    }
    lose_scans<LidarOdometry<>>(without_imu, 14, true);
    lose_scans<LidarInertialOdometry<>>(*drive, 14, true);
  }
}
