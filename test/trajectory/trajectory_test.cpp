#include "chainslam/trajectory/trajectory.hpp"

#include <doctest/doctest.h>

#include <limits>
#include <vector>

using namespace chainslam;

namespace {

Timestamp at(double time) { return Timestamp::from_seconds(time); }
SE3d moved(double x, double y, double z) { return SE3d(SO3d(), Eigen::Vector3d(x, y, z)); }

Trajectory corner() {
  return {{at(0), at(1), at(2), at(4)}, {moved(0, 0, 0), moved(3, 0, 0), moved(3, 4, 0), moved(3, 4, 12)}};
}

}  // namespace

TEST_SUITE("trajectory/trajectory") {
  TEST_CASE("path lengths are those of the polygon") {
    CHECK(path_lengths(corner().poses) == std::vector<double>{0, 3, 7, 19});
    CHECK(path_length(corner()) == 19);
    CHECK(path_length({}) == 0);
    CHECK(path_length({{}, {moved(1, 2, 3)}}) == 0);
  }

  TEST_CASE("the first time out of order is found, repeated times included") {
    CHECK_FALSE(first_disorder(corner().times));
    CHECK_FALSE(first_disorder({}));
    CHECK(first_disorder(std::vector{at(1), at(2), at(2)}) == 2);
    CHECK(first_disorder(std::vector{at(3), at(2), at(1)}) == 1);
  }

  TEST_CASE("a pose with a number that is not finite is found") {
    auto poses = corner().poses;
    CHECK_FALSE(first_not_finite(poses));
    poses[2] = moved(0, std::numeric_limits<double>::quiet_NaN(), 0);
    CHECK(first_not_finite(poses) == 2);
  }

  TEST_CASE("sorting puts poses in the order of time and keeps the first of equal times") {
    const Trajectory mixed{{at(2), at(1), at(2), at(0)},
                           {moved(2, 0, 0), moved(1, 0, 0), moved(9, 0, 0), moved(0, 0, 0)}};
    const Trajectory sorted = sorted_by_time(mixed);
    CHECK(sorted.times == std::vector{at(0), at(1), at(2)});
    CHECK(sorted.poses == std::vector{moved(0, 0, 0), moved(1, 0, 0), moved(2, 0, 0)});
    CHECK(sorted_by_time({}).empty());
    CHECK_THROWS_AS((void)sorted_by_time({{}, {moved(0, 0, 0)}}), std::invalid_argument);
  }

  TEST_CASE("a subset keeps order and times; a transformed trajectory moves as one") {
    const std::vector<Index> indices{3, 1};
    const Trajectory part = subset(corner(), indices);
    CHECK(part.times == std::vector{at(4), at(1)});
    CHECK(part.poses == std::vector{moved(3, 4, 12), moved(3, 0, 0)});
    const SE3d turn(SO3d::exp({0, 0, 1.5}), Eigen::Vector3d(1, 2, 3));
    const Trajectory turned = transformed(turn, corner());
    CHECK(path_length(turned) == doctest::Approx(19));
    CHECK((turned.poses[3].inverse() * turned.poses[0]).translation().isApprox(Eigen::Vector3d(-3, -4, -12)));
  }
}

TEST_SUITE("trajectory/interpolation") {
  TEST_CASE("a pose between two others lies on their geodesic") {
    const Trajectory turning{{at(0), at(2)}, {moved(1, 0, 0), SE3d(SO3d::exp({0, 0, 1.0}), Eigen::Vector3d(3, 0, 0))}};
    const auto middle = pose_at(turning, at(0.5), seconds(2));
    REQUIRE(middle);
    CHECK(middle->rotation().log().isApprox(Eigen::Vector3d(0, 0, 0.25)));
    CHECK(turning.poses[0].local(*middle).isApprox(0.25 * turning.poses[0].local(turning.poses[1])));
  }

  TEST_CASE("a stated time gives its own pose; outside the span and in a gap there is none") {
    const Trajectory path = corner();
    CHECK(*pose_at(path, at(1), seconds(1)) == path.poses[1]);
    CHECK(*pose_at(path, at(0), seconds(1)) == path.poses[0]);
    CHECK(*pose_at(path, at(4), seconds(1)) == path.poses[3]);
    CHECK_FALSE(pose_at(path, at(-0.001), seconds(10)));
    CHECK_FALSE(pose_at(path, at(4.001), seconds(10)));
    CHECK_FALSE(pose_at(path, at(3), seconds(1.9)));
    CHECK(pose_at(path, at(3), seconds(2))->translation().isApprox(Eigen::Vector3d(3, 4, 6)));
    CHECK_FALSE(pose_at({}, at(0), seconds(1)));
    CHECK_FALSE(pose_at({{}, {moved(0, 0, 0)}}, at(0), seconds(1)));
  }
}
