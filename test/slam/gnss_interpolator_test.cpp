#include "chainslam/slam/gnss_candidates.hpp"

#include <doctest/doctest.h>

#include <limits>
#include <map>
#include "support/numbers.hpp"

namespace chainslam {
namespace {

using test::nan;

GnssFix fix_at(double time, const Eigen::Vector3d& position, GnssQuality quality = GnssQuality::three_dimensional,
               double variance = 1) {
  return {Timestamp::from_seconds(time), position, variance * Eigen::Matrix3d::Identity(), quality};
}

/// An interpolator together with what it assigned.
struct Receiver {
  GnssInterpolator interpolator;
  std::map<Index, GnssFix> assigned;

  explicit Receiver(Duration max_gap = seconds(2)) : interpolator(max_gap) {}

  void keyframe(Index id, double time) { interpolator.add(KeyframeId{id}, Timestamp::from_seconds(time)); }
  void fix(const GnssFix& fix) {
    interpolator.add(fix, [this](KeyframeId id, const GnssFix& interpolated) {
      CHECK(assigned.emplace(id.value, interpolated).second);
    });
  }
};

TEST_SUITE("slam/gnss_interpolator") {
  TEST_CASE("a keyframe gets the position between the fixes around it, by its share of the time") {
    Receiver receiver;
    receiver.fix(fix_at(10, {4e6, 1e6, 4.7e6}, GnssQuality::rtk_fixed, 1));
    receiver.keyframe(0, 10.25);
    receiver.keyframe(1, 10.5);
    CHECK(receiver.assigned.empty());
    receiver.fix(fix_at(11, {4e6 + 8, 1e6 - 4, 4.7e6}, GnssQuality::differential, 5));
    REQUIRE(receiver.assigned.size() == 2);
    const GnssFix& quarter = receiver.assigned.at(0);
    CHECK(quarter.time == Timestamp::from_seconds(10.25));
    CHECK((quarter.position_ecef - Eigen::Vector3d(4e6 + 2, 1e6 - 1, 4.7e6)).norm() < 1e-8);
    CHECK(quarter.covariance_ecef.isApprox(2 * Eigen::Matrix3d::Identity()));
    CHECK(quarter.quality == GnssQuality::differential);
    CHECK((receiver.assigned.at(1).position_ecef - Eigen::Vector3d(4e6 + 4, 1e6 - 2, 4.7e6)).norm() < 1e-8);
  }

  TEST_CASE("keyframes at the very times of fixes get those fixes' positions") {
    Receiver receiver;
    receiver.fix(fix_at(1, {1, 0, 0}));
    receiver.keyframe(0, 1);
    receiver.keyframe(1, 2);
    receiver.fix(fix_at(2, {3, 0, 0}));
    CHECK(receiver.assigned.at(0).position_ecef == Eigen::Vector3d(1, 0, 0));
    CHECK(receiver.assigned.at(1).position_ecef == Eigen::Vector3d(3, 0, 0));
  }

  TEST_CASE("nothing is assigned before the first fix, over an outage, or after the last fix") {
    Receiver receiver(seconds(2));
    receiver.keyframe(0, 0.5);
    receiver.fix(fix_at(1, {0, 0, 0}));
    receiver.keyframe(1, 2);
    receiver.fix(fix_at(3.1, {0, 0, 0}));
    receiver.keyframe(2, 4);
    receiver.fix(fix_at(5.1, {0, 0, 0}));
    receiver.keyframe(3, 5.5);
    CHECK(receiver.assigned.size() == 1);
    CHECK(receiver.assigned.contains(2));
  }

  TEST_CASE("fixes without a position are no ends to interpolate between") {
    for (const GnssFix& bad : {fix_at(1.5, {100, 0, 0}, GnssQuality::none), fix_at(1.5, {nan, 0, 0}),
                               fix_at(1.5, {std::numeric_limits<double>::infinity(), 0, 0}),
                               fix_at(1.5, {100, 0, 0}, GnssQuality::three_dimensional, nan)}) {
      Receiver receiver;
      receiver.fix(fix_at(1, {0, 0, 0}));
      receiver.keyframe(0, 1.25);
      receiver.fix(bad);
      CHECK(receiver.assigned.empty());
      receiver.fix(fix_at(2, {4, 0, 0}));
      CHECK(receiver.assigned.at(0).position_ecef == Eigen::Vector3d(1, 0, 0));
    }
  }

  TEST_CASE("fixes that come late or twice are left out") {
    Receiver receiver;
    receiver.fix(fix_at(1, {0, 0, 0}));
    receiver.keyframe(0, 1.5);
    receiver.fix(fix_at(1, {9, 9, 9}));
    receiver.fix(fix_at(0.5, {9, 9, 9}));
    CHECK(receiver.assigned.empty());
    receiver.fix(fix_at(2, {2, 0, 0}));
    CHECK(receiver.assigned.at(0).position_ecef == Eigen::Vector3d(1, 0, 0));
  }
}

}  // namespace
}  // namespace chainslam
