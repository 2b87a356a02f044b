#include <doctest/doctest.h>

#include <algorithm>
#include <memory>
#include <string>
#include <vector>

#include "chainslam/slam/back_end.hpp"
#include "slam/scripted.hpp"
#include "slam/street.hpp"
#include "support/numbers.hpp"

namespace chainslam {
namespace {

using test::degree;
using test::rotation_error;
using test::translation_error;

constexpr Index scans_each = 24;  ///< keyframes of a session, two metres apart

/// Drives along two sides of one block, in scans: each starts elsewhere, in a frame of its own, with perfect odometry.
struct ScannedDrives {
  test::Street street;
  std::vector<SE3d> truth;
  std::vector<SE3d> T_world_odom;

  explicit ScannedDrives(int sessions) {
    const std::vector<SE3d> round = test::way_round();
    for (int session = 0; session < sessions; ++session) {
      for (Index i = 0; i < scans_each; ++i)
        truth.push_back(round[static_cast<std::size_t>(i + 4 * session)] * SE3d(SO3d(), {0, 0.8 * session, 0}));
      T_world_odom.push_back(truth[static_cast<std::size_t>(session * scans_each)]);
    }
  }

  void drive(BackEnd<>& back_end, Index session) const {
    back_end.begin_session(std::string(1, static_cast<char>('a' + session)));
    for (Index i = 0; i < scans_each; ++i) {
      const auto at = static_cast<std::size_t>(session * scans_each + i);
      Keyframe keyframe = test::keyframe_at(i, T_world_odom[static_cast<std::size_t>(session)].inverse() * truth[at]);
      keyframe.cloud = street.scan(truth[at], Rng(1000 + at), 4000);
      back_end.add(std::move(keyframe));
      back_end.add(test::fix_at(Timestamp::from_seconds(i), truth[at].translation()));
    }
  }
};

}  // namespace

TEST_SUITE("slam: several sessions in scans") {
  TEST_CASE("sessions that know nothing of each other are joined by what their scans look like, to the centimetre") {
    const ScannedDrives drives(3);
    BackEnd<> back_end({}, LoopCloser<>({.submap = {.radius = 6}}), ChainedCloser(), MapMerger<>({.submap_radius = 8}));
    for (Index session = 0; session < 3; ++session) drives.drive(back_end, session);
    const auto map = back_end.finish();
    const auto count = [&](ClosureKind kind) { return std::ranges::count(map->closures, kind, &LoopClosure::kind); };
    MESSAGE(count(ClosureKind::merge), " merging, ", count(ClosureKind::direct), " direct, ",
            count(ClosureKind::chained), " chained closures, ", map->refusals.size(), " refused");
    CHECK(back_end.counts().merges == 2);
    CHECK(count(ClosureKind::direct) > 0);
    CHECK(count(ClosureKind::chained) > 0);
    for (Index session = 0; session < 3; ++session) {
      CHECK(map->sessions[static_cast<std::size_t>(session)].frame == SessionId{0});
      double metres = 0, radians = 0;
      for (Index i = session * scans_each; i < (session + 1) * scans_each; ++i) {
        const auto at = static_cast<std::size_t>(i);
        const SE3d expected = drives.T_world_odom[0].inverse() * drives.truth[at];
        metres = std::max(metres, translation_error(expected, map->keyframes[at].T_map_body));
        radians = std::max(radians, rotation_error(expected, map->keyframes[at].T_map_body));
      }
      MESSAGE("session ", session, ": ", metres, " m, ", radians / degree, " degrees at most");
      CHECK(metres < 0.02);
      CHECK(radians < 0.05 * degree);
    }
  }
}

}  // namespace chainslam
