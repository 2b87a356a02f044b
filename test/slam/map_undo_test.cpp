#include "chainslam/slam/map_undo.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include "chainslam/factor_graph/batch_optimizer.hpp"
#include "chainslam/factor_graph/factor_graph.hpp"
#include "chainslam/slam/back_end.hpp"
#include "slam/block_drives.hpp"
#include "slam/scripted.hpp"

namespace chainslam {
namespace {

using test::DrivesRoundTheBlock;
using test::GnssPlaces;
using test::per_session;
using test::ScriptedRegistration;
using test::TruthCloser;

using UndoMerger = MapMerger<GnssPlaces, ScriptedRegistration>;
using UndoBackEnd = BackEnd<Unrepeated<TruthCloser>, ChainedCloser, UndoMerger>;

BackEndOptions without_earth() {  // fixes find places, and hold nothing
  BackEndOptions options;
  options.graph.gnss.enabled = false;
  return options;
}

UndoBackEnd undo_back_end(const DrivesRoundTheBlock& drives, const BackEndOptions& options,
                          const UndoneClosures& undone = {}) {
  UndoMerger merger({}, {&drives}, {drives.script});
  merger.forbid(undone);
  return UndoBackEnd(options, {drives.closer(), undone}, ChainedCloser(), std::move(merger));
}

SlamMap driven(const DrivesRoundTheBlock& drives, Index sessions, const BackEndOptions& options) {
  auto back_end = undo_back_end(drives, options);
  for (Index session = 0; session < sessions; ++session) drives.drive(back_end, session);
  return *back_end.finish();
}

/// Drives of which one was never made.
DrivesRoundTheBlock all_but(const DrivesRoundTheBlock& drives, Index session) {
  DrivesRoundTheBlock left = drives;
  left.script = std::make_shared<test::Script>();
  const auto erase = [&](std::vector<SE3d>& poses) {
    poses.erase(poses.begin() + session * per_session, poses.begin() + (session + 1) * per_session);
  };
  erase(left.truth);
  erase(left.odometry);
  return left;
}

/// The optimum of a map's records by the batch optimizer, from where odometry puts the keyframes.
std::vector<SE3d> batch_optimum(const SlamMap& map, const MapGraphOptions& options) {
  PoseGraph graph;
  std::vector<SE3d> T_map_odom(map.sessions.size());
  for (const Session& session : map.sessions)  // of a session's start only what the map says is taken
    if (session.keyframes > 0) {
      const Keyframe& start = map.keyframes[static_cast<std::size_t>(session.first_keyframe)];
      T_map_odom[static_cast<std::size_t>(session.id.value)] = start.T_map_body * start.T_odom_body.inverse();
    }
  for (const Keyframe& one : map.keyframes)
    graph.add_value(T_map_odom[static_cast<std::size_t>(one.session.value)] * one.T_odom_body);
  const auto noise = [](const SqrtInformation<6>& root, double weight) {
    return NoiseModel<6>::from_information(weight * root.transpose() * root);
  };
  for (const Session& session : map.sessions)
    if (session.keyframes > 0 && !session.prior_sqrt_information.isZero(0))
      graph.add_prior(session.first_keyframe, session.prior, noise(session.prior_sqrt_information, 1));
  for (const OdometryMeasurement& step : map.odometry)
    graph.add_between(step.from.value, step.to.value, step.T_from_to, noise(step.sqrt_information, 1));
  const GroupGnc outliers;
  for (const LoopClosure& closure : map.closures)
    if (closure.is_factor())
      graph.add_between(
          closure.from.value, closure.to.value, closure.T_from_to,
          noise(closure.sqrt_information, closure.verdict == ClosureVerdict::accepted ? 1 : outliers.outlier_weight));
  REQUIRE_FALSE(options.gnss.enabled);
  // Full steps to the last digits: damped ones end where costs differ by rounding only.
  REQUIRE(
      optimize(graph, GaussNewton{.max_iterations = 30, .relative_tolerance = 0, .absolute_tolerance = 1e-24}).ok());
  std::vector<SE3d> poses;
  for (const Keyframe& one : map.keyframes) poses.push_back(graph[one.id.value]);
  return poses;
}

double farthest_from(const std::vector<SE3d>& poses, const SlamMap& map) {
  double most = poses.size() == map.keyframes.size() ? 0 : 1;
  for (std::size_t i = 0; i < map.keyframes.size(); ++i)
    most = std::max(most, map.keyframes[i].T_map_body.local(poses[i]).norm());
  return most;
}

std::vector<Index> frames_in(const SlamMap& map) {
  std::vector<Index> values;
  for (const Session& session : map.sessions) values.push_back(session.frame.value);
  return values;
}

/// That all numbers of a map's records are its own.
void check_numbers(const SlamMap& map) {
  Index next = 0;
  for (std::size_t s = 0; s < map.sessions.size(); ++s) {
    CHECK(map.sessions[s].id == SessionId{to_index(s)});
    CHECK(map.sessions[s].first_keyframe == next);
    next = map.sessions[s].end_keyframe();
    REQUIRE(map.sessions[s].frame.value < to_index(map.sessions.size()));
    CHECK(map.sessions[static_cast<std::size_t>(map.sessions[s].frame.value)].frame == map.sessions[s].frame);
  }
  CHECK(next == to_index(map.keyframes.size()));
  for (std::size_t i = 0; i < map.keyframes.size(); ++i) {
    CHECK(map.keyframes[i].id == KeyframeId{to_index(i)});
    const Session& session = map.sessions[static_cast<std::size_t>(map.keyframes[i].session.value)];
    CHECK((to_index(i) >= session.first_keyframe && to_index(i) < session.end_keyframe()));
    if (map.keyframes[i].gnss_arrival.after.valid())
      CHECK(map.keyframes[static_cast<std::size_t>(map.keyframes[i].gnss_arrival.after.value)].session == session.id);
  }
  CHECK(map.odometry.size() + map.sessions.size() == map.keyframes.size());
  for (const auto* closures : {&map.closures, &map.refusals})
    for (const LoopClosure& closure : *closures) {
      CHECK(closure.from.value < to_index(map.keyframes.size()));
      CHECK(closure.cause < to_index(map.closures.size()));
    }
}

Index first_of_kind(const SlamMap& map, ClosureKind kind, SessionId to) {
  for (std::size_t i = 0; i < map.closures.size(); ++i)
    if (map.closures[i].kind == kind && detail::session_of(map, map.closures[i].to) == to) return to_index(i);
  FAIL("no such closure");
  return -1;
}

bool same_poses(const SlamMap& a, const SlamMap& b) {
  return std::ranges::equal(a.keyframes, b.keyframes, {}, &Keyframe::T_map_body, &Keyframe::T_map_body);
}

bool same_closures(const std::vector<LoopClosure>& a, const std::vector<LoopClosure>& b) {
  return std::ranges::equal(a, b, [](const LoopClosure& x, const LoopClosure& y) {
    return x.from == y.from && x.to == y.to && x.T_from_to == y.T_from_to && x.kind == y.kind &&
           x.sqrt_information == y.sqrt_information && x.verdict == y.verdict && x.cause == y.cause;
  });
}

}  // namespace

TEST_SUITE("slam/map_undo") {
  TEST_CASE("what remains is at its optimum within 1e-9, as the batch optimizer finds it from odometry") {
    const BackEndOptions options = without_earth();
    const DrivesRoundTheBlock drives(3);
    const SlamMap map = driven(drives, 3, options);
    REQUIRE(frames_in(map) == std::vector<Index>{0, 0, 0});
    const std::vector<UndoRequest> requests = {{},
                                               {.sessions = {SessionId{0}}},
                                               {.sessions = {SessionId{1}}},
                                               {.sessions = {SessionId{2}}},
                                               {.sessions = {SessionId{0}, SessionId{2}}},
                                               {.closures = {first_of_kind(map, ClosureKind::direct, SessionId{2})}},
                                               {.closures = {first_of_kind(map, ClosureKind::chained, SessionId{2})}},
                                               {.closures = {first_of_kind(map, ClosureKind::merge, SessionId{1})}},
                                               {.closures = {first_of_kind(map, ClosureKind::merge, SessionId{2})}}};
    for (const UndoRequest& request : requests) {
      const UndoneMap undone = undo(map, request, {}, options.graph);
      REQUIRE(undone.optimization.ok());
      check_numbers(undone.map);
      CHECK(undone.map.sessions.size() == 3 - request.sessions.size());
      CHECK(undone.removed_closures == to_index(map.closures.size() - undone.map.closures.size()));
      CHECK(undone.removed_keyframes == to_index(request.sessions.size()) * per_session);
      CHECK(farthest_from(batch_optimum(undone.map, options.graph), undone.map) < 1e-9);
    }
  }

  TEST_CASE("a merge that is undone parts its sides; the others stay together") {
    const BackEndOptions options = without_earth();
    const DrivesRoundTheBlock drives(3);
    const SlamMap map = driven(drives, 3, options);
    const Index merge = first_of_kind(map, ClosureKind::merge, SessionId{2});
    const UndoneMap undone = undo(map, {.closures = {merge}}, {}, options.graph);
    CHECK(frames_in(undone.map) == std::vector<Index>{0, 0, 2});
    for (const LoopClosure& closure : undone.map.closures)
      CHECK((detail::session_of(undone.map, closure.from) == SessionId{2}) ==
            (detail::session_of(undone.map, closure.to) == SessionId{2}));
    CHECK(undone.removed_closures > 3);
    // The two others are where they were without the third: only their own measurements hold them.
    const UndoneMap removed = undo(map, {.sessions = {SessionId{2}}}, {}, options.graph);
    for (Index i = 0; i < 2 * per_session; ++i) {
      const auto at = static_cast<std::size_t>(i);
      CHECK(undone.map.keyframes[at].T_map_body.local(removed.map.keyframes[at].T_map_body).norm() < 1e-9);
    }
  }

  TEST_CASE("fixes hold what remains; the optimum is the same from anywhere") {
    const BackEndOptions options;
    const DrivesRoundTheBlock drives(3);
    const SlamMap map = driven(drives, 3, options);
    const UndoRequest request{.sessions = {SessionId{1}}};
    const UndoneMap undone = undo(map, request, {}, options.graph);
    REQUIRE(undone.optimization.ok());
    SlamMap from_scratch = without(map, request).map;
    Rng rng(3);
    for (Keyframe& one : from_scratch.keyframes) one.T_map_body = one.T_map_body * test::random_motion(rng, 0.1, 0.01);
    REQUIRE(settle(from_scratch, options.graph).ok());
    double most = 0;
    for (std::size_t i = 0; i < from_scratch.keyframes.size(); ++i)
      most = std::max(most, from_scratch.keyframes[i].T_map_body.local(undone.map.keyframes[i].T_map_body).norm());
    CHECK(most < 1e-9);
  }

  TEST_CASE("of a frame whose session goes, those that no closure had put there stay together") {
    const DrivesRoundTheBlock drives(3);
    auto back_end = BackEnd<TruthCloser, ChainedCloser, NoMerging>({}, drives.closer());
    for (Index session = 0; session < 3; ++session) drives.drive(back_end, session, false);
    SlamMap map = *back_end.finish();
    std::erase_if(map.closures, [&](const LoopClosure& closure) {
      return detail::session_of(map, closure.from) != detail::session_of(map, closure.to);
    });
    for (Session& session : map.sessions) session.frame = SessionId{0};
    const UndoneMap undone = undo(map, {.sessions = {SessionId{0}}});
    REQUIRE(undone.optimization.ok());
    CHECK(frames_in(undone.map) == std::vector<Index>{0, 0});
    check_numbers(undone.map);
  }

  TEST_CASE("what is not there cannot be undone, and not all of a map") {
    const DrivesRoundTheBlock drives(1);
    const SlamMap map = driven(drives, 1, {});
    CHECK_THROWS_WITH_AS(static_cast<void>(without(map, {.sessions = {SessionId{1}}})), "undo: there is no session 1",
                         std::invalid_argument);
    CHECK_THROWS_WITH_AS(static_cast<void>(without(map, {.closures = {-1}})), "undo: there is no closure -1",
                         std::invalid_argument);
    CHECK_THROWS_WITH_AS(static_cast<void>(without(map, {.sessions = {SessionId{0}}})),
                         "undo: no session would be left", std::invalid_argument);
  }
}

TEST_SUITE("slam/map_replay") {
  TEST_CASE("a map's own records make the same map again, also where fixes came late and several at once") {
    const DrivesRoundTheBlock drives(3);
    auto first = undo_back_end(drives, {});
    for (Index session = 0; session < 3; ++session) {
      first.begin_session("drive");
      for (Index i = 0; i < per_session; ++i) {
        const auto at = static_cast<std::size_t>(session * per_session + i);
        std::vector<FrameRecord> frames;
        for (const double before : {0.5, 0.0}) {
          FrameRecord frame;
          frame.time = Timestamp::from_seconds(i - before);
          frame.T_odom_body = drives.odometry[at];
          frame.covariance = PackedCovariance(Matrix6d(1e-6 * (i + 1) * Matrix6d::Identity()));
          frames.push_back(frame);
        }
        first.add(frames);
        first.add(test::keyframe_at(i, drives.odometry[at]));
        if (i % 5 != 4) continue;
        for (const Index late : {4, 2}) {  // two fixes after one keyframe: the second finds two keyframes
          const Index then = i - late;
          const auto there = static_cast<std::size_t>(session * per_session + then);
          first.add(test::fix_at(Timestamp::from_seconds(then), drives.truth[there].translation()));
        }
      }
    }
    const auto map = first.finish();
    REQUIRE(frames_in(*map) == std::vector<Index>{0, 0, 0});
    REQUIRE(std::ranges::any_of(map->keyframes, [](const Keyframe& one) { return one.gnss_arrival.with_previous; }));
    const DrivesRoundTheBlock same(3);
    auto again = undo_back_end(same, {});
    replay(*map, again);
    const auto replayed = again.finish();
    CHECK(same_closures(map->closures, replayed->closures));
    CHECK(same_closures(map->refusals, replayed->refusals));
    CHECK(same_poses(*map, *replayed));
    CHECK(
        std::ranges::equal(map->keyframes, replayed->keyframes, {}, &Keyframe::gnss_arrival, &Keyframe::gnss_arrival));
    CHECK(map->frames.size() == replayed->frames.size());
  }

  TEST_CASE("a session that is left out might never have been: the same decisions and poses") {
    for (const Index gone : {0, 1, 2}) {
      const DrivesRoundTheBlock drives(3);
      const SlamMap map = driven(drives, 3, {});
      const DrivesRoundTheBlock others = all_but(drives, gone), others_again = all_but(drives, gone);
      const SlamMap never = driven(others, 2, {});
      auto back_end = undo_back_end(others_again, {});
      replay(without(map, {.sessions = {SessionId{gone}}}).map, back_end);
      const auto replayed = back_end.finish();
      CHECK(same_closures(never.closures, replayed->closures));
      CHECK(same_closures(never.refusals, replayed->refusals));
      CHECK(same_poses(never, *replayed));
    }
  }

  TEST_CASE("what was undone is not found again: the closure itself, and what would merge to the same place") {
    const DrivesRoundTheBlock drives(2);
    const SlamMap map = driven(drives, 2, {});
    const auto replayed_without = [&](Index position) {
      const DrivesRoundTheBlock same(2);
      const UndoneMap undone = without(map, {.closures = {position}});
      auto back_end = undo_back_end(same, {}, undone.undone);
      replay(undone.map, back_end);
      return *back_end.finish();
    };
    const Index direct = first_of_kind(map, ClosureKind::direct, SessionId{1});
    const LoopClosure& closure = map.closures[static_cast<std::size_t>(direct)];
    const auto is_it = [&](const LoopClosure& one) { return one.from == closure.from && one.to == closure.to; };
    const SlamMap unclosed = replayed_without(direct);
    CHECK(std::ranges::none_of(unclosed.closures, is_it));
    CHECK(std::ranges::any_of(unclosed.refusals, [&](const LoopClosure& one) {
      return is_it(one) && one.verdict == ClosureVerdict::reverted;
    }));
    CHECK(frames_in(unclosed) == std::vector<Index>{0, 0});
    const SlamMap unmerged = replayed_without(first_of_kind(map, ClosureKind::merge, SessionId{1}));
    CHECK(frames_in(unmerged) == std::vector<Index>{0, 1});
    CHECK(std::ranges::any_of(unmerged.refusals, [&](const LoopClosure& one) {
      return one.kind == ClosureKind::merge && one.verdict == ClosureVerdict::reverted;
    }));
  }
}

}  // namespace chainslam
