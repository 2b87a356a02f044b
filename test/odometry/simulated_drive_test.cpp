#include <doctest/doctest.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <optional>
#include <variant>
#include <vector>

#include "chainslam/odometry/lidar_inertial_odometry.hpp"
#include "chainslam/sensor/frame.hpp"
#include "simulator/town_drive.hpp"
#include "support/graph_nees.hpp"
#include "support/quick.hpp"

using namespace chainslam;

namespace {

/// Where odometry and the truth put the body at the end of every scan, and the LiDAR in the frame of the local map.
struct FollowedDrive {
  std::vector<SE3d> odometry, truth, lidar_in_map, true_lidar;
  std::vector<FrameRecord> frames;
};

FollowedDrive follow_drive(simulator::TownDrive& drive, int scans) {
  LidarInertialOdometryOptions<> options;
  options.T_body_lidar = drive.lidar().options().T_body_lidar;
  LidarInertialOdometry<> odometry(options);
  FollowedDrive followed;
  const auto take = [&](const Frame& frame) {
    followed.frames.push_back(record_of(frame));
    followed.odometry.push_back(frame.T_odom_body);
    followed.truth.push_back(drive.truth(frame.time));
    followed.lidar_in_map.push_back(T_odom_body(odometry.state()) * T_body_lidar(odometry.state()));
    followed.true_lidar.push_back(followed.truth.back() * drive.lidar().true_T_body_lidar());
  };
  for (int taken = 0; taken < scans;) {
    const std::optional<Packet> packet = drive.next();
    if (!packet) break;
    if (std::holds_alternative<LidarScan>(*packet)) ++taken;
    if (const auto frame = odometry.process(*packet)) take(*frame);
  }
  return followed;
}

/// By how much poses have come out of level since the first, radians.
double out_of_level(const std::vector<SE3d>& poses, const std::vector<SE3d>& truth, std::size_t i) {
  const SO3d turned = truth[0].rotation() * poses[0].rotation().inverse() * poses[i].rotation();
  return (turned * truth[i].rotation().inverse()).log().head<2>().norm();
}

}  // namespace

TEST_SUITE("odometry/simulated_drive") {
  // Its lasers are up to 0.2 degrees off, which bends the map.
  TEST_CASE("a drive through a town stays level over a map that does not, and errs as the back end expects" *
            doctest::skip(test::quick())) {
    simulator::TownDrive drive(simulator::preset("town-sessions").value(), 1, 2);
    const FollowedDrive followed = follow_drive(drive, 400);
    double map = 0, odometry = 0;
    constexpr double degree = std::numbers::pi / 180;
    for (std::size_t i = 0; i < followed.truth.size(); ++i) {
      map = std::max(map, out_of_level(followed.lidar_in_map, followed.true_lidar, i) / degree);
      if (i >= 200) odometry = std::max(odometry, out_of_level(followed.odometry, followed.truth, i) / degree);
    }
    const test::GraphNees nees(followed.frames, followed.truth, 3.0);
    const test::NeesRatio one = nees.over(1), ten = nees.over(10), hundred = nees.over(100);
    MESSAGE("out of level: map ", map, ", odometry ", odometry,
            " degrees; errors over expected over 1, 10, 100 m: translation ", one.translation, ", ", ten.translation,
            ", ", hundred.translation, ", rotation ", one.rotation, ", ", ten.rotation, ", ", hundred.rotation);
    CHECK(map > 1.0);
    CHECK(odometry < 0.6 * map);
    // More accurate than on real drives, which the noise is set on.
    for (const test::NeesRatio& ratio : {one, ten, hundred}) {
      CHECK(ratio.translation > 0.1);
      CHECK(ratio.translation < 1.0);
      CHECK(ratio.rotation > 0.1);
      CHECK(ratio.rotation < 1.0);
    }
  }
}
