#include "chainslam/slam/detail/fix_evidence.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <numbers>
#include <vector>

#include "slam/scripted.hpp"
#include "slam/street.hpp"
#include "support/property.hpp"

namespace chainslam {
namespace {

using test::for_all;

/// Two drives along a bent street, each in a frame of its own, with fixes of metres' noise and a bias for each.
struct FixedDrives {
  static constexpr Index each = 60;
  SlamMap map;
  SE3d T_a_b;  ///< the right one
  Rng rng;

  explicit FixedDrives(Rng random, double step = 3.0) : rng(random) {
    const SE3d T_world_frame[] = {SE3d(SO3d::exp({0, 0, 0.4}), {20, 5, 0}), SE3d(SO3d::exp({0, 0, 2.5}), {-70, 60, 1})};
    T_a_b = T_world_frame[0].inverse() * T_world_frame[1];
    for (Index s = 0; s < 2; ++s) {
      map.sessions.push_back({SessionId{s}, {}, s * each, each, SessionId{s}, {}, {}});
      const Eigen::Vector3d bias(rng.uniform(-3, 3), rng.uniform(-3, 3), rng.uniform(-10, 10));
      Eigen::Vector3d at(s * step * each / 2, 0, 0);  // half of the way is shared
      for (Index i = 0; i < each; ++i) {
        const double heading = 0.4 * std::sin(0.01 * step * (i + s * each / 2.0));
        at += step * Eigen::Vector3d(std::cos(heading), std::sin(heading), 0);
        Keyframe keyframe = test::keyframe_at(i, T_world_frame[s].inverse() * SE3d(SO3d(), at));
        keyframe.id = KeyframeId{s * each + i};
        keyframe.session = SessionId{s};
        const Eigen::Vector3d noise(rng.normal(0, 1.5), rng.normal(0, 1.5), rng.normal(0, 4));
        keyframe.gnss = test::fix_at(keyframe.time, at + bias + noise);
        map.keyframes.push_back(keyframe);
      }
    }
  }

  /// Adds metres to this share of the fixes of both drives, each in another direction.
  void spoil(double share, double metres) {
    for (Keyframe& keyframe : map.keyframes) {
      if (10.0 * share <= 7 * keyframe.id.value % 10) continue;
      const double direction = rng.uniform(0, 2 * std::numbers::pi);
      keyframe.gnss->position_ecef +=
          test::ecef(metres * Eigen::Vector3d(std::cos(direction), std::sin(direction), 0)) - test::ecef({0, 0, 0});
    }
  }
  void bias_second(const Eigen::Vector3d& by) {
    for (Index i = each; i < 2 * each; ++i)
      map.keyframes[static_cast<std::size_t>(i)].gnss->position_ecef += test::ecef(by) - test::ecef({0, 0, 0});
  }

  [[nodiscard]] detail::FixVerdict ask(const SE3d& T, const FixEvidenceOptions& options = {}) const {
    return detail::FixEvidence(options)(
        map, [](const Session& one) { return one.id == SessionId{0}; },
        [](const Session& one) { return one.id == SessionId{1}; }, T);
  }
  /// The right transform, but for a motion where the second drive begins.
  [[nodiscard]] SE3d but_for(const SE3d& motion) const {
    const SE3d& start = map.keyframes[each].T_map_body;
    return T_a_b * (start * motion * start.inverse());
  }
};

SE3d turned(double degrees) { return SE3d(SO3d::exp({0, 0, degrees * std::numbers::pi / 180}), {0, 0, 0}); }

}  // namespace

TEST_SUITE("slam/fix_evidence") {
  TEST_CASE("fixes agree where sessions lie right, and contradict what is far off or turned") {
    for_all(50, [](Rng& rng, int) {
      const FixedDrives drives(rng);
      CHECK(drives.ask(drives.T_a_b) == detail::FixVerdict::agree);
      CHECK(drives.ask(drives.but_for(test::shift(3, 2, 0))) == detail::FixVerdict::agree);
      CHECK(drives.ask(drives.but_for(test::shift(70, 0, 0))) == detail::FixVerdict::contradict);
      CHECK(drives.ask(drives.but_for(test::shift(0, 70, 0))) == detail::FixVerdict::contradict);
      CHECK(drives.ask(drives.but_for(turned(90))) == detail::FixVerdict::contradict);
      CHECK(drives.ask(drives.but_for(turned(180))) == detail::FixVerdict::contradict);
      CHECK(drives.ask(drives.T_a_b.inverse()) == detail::FixVerdict::contradict);
      CHECK(drives.ask(drives.but_for(turned(45))) != detail::FixVerdict::agree);
    });
  }

  TEST_CASE("three in ten fixes that are wrong by 50 m change nothing") {
    for_all(50, [](Rng& rng, int) {
      FixedDrives drives(rng);
      drives.spoil(0.3, 50);
      CHECK(drives.ask(drives.T_a_b) == detail::FixVerdict::agree);
      CHECK(drives.ask(drives.but_for(test::shift(70, 0, 0))) == detail::FixVerdict::contradict);
      CHECK(drives.ask(drives.but_for(turned(180))) == detail::FixVerdict::contradict);
    });
  }

  TEST_CASE("nor do two in five that are wrong by 300 m: what they would make of the others is left out") {
    for_all(50, [](Rng& rng, int) {
      FixedDrives drives(rng);
      drives.spoil(0.4, 300);
      CHECK(drives.ask(drives.T_a_b) == detail::FixVerdict::agree);
    });
  }

  TEST_CASE("fixes of one drive that are all off by 200 m contradict where it truly is") {
    FixedDrives drives(Rng(3));
    drives.bias_second({0, 200, 0});
    CHECK(drives.ask(drives.T_a_b) == detail::FixVerdict::contradict);
  }

  TEST_CASE("few fixes, fixes on one spot and fixes of no use say nothing, nor do any if they are not asked") {
    FixedDrives drives(Rng(4));
    CHECK(drives.ask(drives.T_a_b, {.max_difference = 0}) == detail::FixVerdict::silent);
    CHECK(drives.ask(drives.T_a_b, {.min_fixes = FixedDrives::each + 1}) == detail::FixVerdict::silent);
    CHECK(drives.ask(drives.T_a_b, {.min_fixes = FixedDrives::each}) == detail::FixVerdict::agree);
    CHECK(drives.ask(drives.T_a_b, {.max_sigma = 0.5}) == detail::FixVerdict::silent);
    const FixedDrives standing(Rng(4), 0.1);
    CHECK(standing.ask(standing.T_a_b) == detail::FixVerdict::silent);
    CHECK(standing.ask(standing.but_for(test::shift(200, 0, 0))) == detail::FixVerdict::silent);
  }

  TEST_CASE("a drive that stays on one spot may be contradicted, but says nothing of how it is turned") {
    FixedDrives drives(Rng(5));
    for (Index i = FixedDrives::each; i < 2 * FixedDrives::each; ++i) {
      Keyframe& keyframe = drives.map.keyframes[static_cast<std::size_t>(i)];
      keyframe = drives.map.keyframes[FixedDrives::each];
      keyframe.id = KeyframeId{i};
    }
    CHECK(drives.ask(drives.T_a_b) == detail::FixVerdict::silent);
    CHECK(drives.ask(drives.but_for(test::shift(150, 0, 0))) == detail::FixVerdict::contradict);
  }

  TEST_CASE("closures are contradicted that hold two sessions where their fixes do not put them") {
    for (const bool wrong : {false, true}) {
      FixedDrives drives(Rng(6));
      SlamMap& map = drives.map;
      const SE3d T = wrong ? drives.but_for(test::shift(70, 0, 0)) : drives.T_a_b;
      for (Index i = FixedDrives::each; i < 2 * FixedDrives::each; ++i) {
        SE3d& pose = map.keyframes[static_cast<std::size_t>(i)].T_map_body;
        pose = T * pose;
      }
      map.sessions[1].frame = SessionId{0};
      for (const Index to : {20, 70, 71})
        map.closures.push_back({.from = KeyframeId{3}, .to = KeyframeId{to}, .T_from_to = {}});
      map.closures.back().verdict = ClosureVerdict::inconsistent;
      const detail::Table<Index> found = detail::contradicted_closures(map, detail::FixEvidence());
      REQUIRE(found.size() == (wrong ? 1 : 0));
      if (wrong) CHECK(found[0] == 1);
    }
  }
}

}  // namespace chainslam
