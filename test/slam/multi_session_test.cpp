#include <doctest/doctest.h>

#include <algorithm>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/slam/back_end.hpp"
#include "chainslam/slam/pipeline.hpp"
#include "slam/block_drives.hpp"
#include "slam/scripted.hpp"

namespace chainslam {
namespace {

using test::DrivesRoundTheBlock;
using test::farthest_apart;
using test::GnssPlaces;
using test::inter_session_error;
using test::per_session;
using test::ScriptedPlaces;
using test::ScriptedRegistration;
using test::translation_error;
using test::TruthCloser;

using GnssBackEnd = BackEnd<TruthCloser, ChainedCloser, MapMerger<GnssPlaces, ScriptedRegistration>>;
using UnmergedBackEnd = BackEnd<TruthCloser, ChainedCloser, NoMerging>;
using ScriptedBackEnd = BackEnd<TruthCloser, ChainedCloser, MapMerger<ScriptedPlaces, ScriptedRegistration>>;

GnssBackEnd gnss_back_end(const DrivesRoundTheBlock& drives, const BackEndOptions& options = {}) {
  return GnssBackEnd(options, drives.closer(), ChainedCloser(),
                     MapMerger<GnssPlaces, ScriptedRegistration>({}, {&drives}, {drives.script}));
}
ScriptedBackEnd scripted_back_end(const DrivesRoundTheBlock& drives, const MergeOptions& merging,
                                  const BackEndOptions& options = {}) {
  return ScriptedBackEnd(options, drives.closer(), ChainedCloser(),
                         MapMerger<ScriptedPlaces, ScriptedRegistration>(merging, {drives.script}, {drives.script}));
}

Index count(const SlamMap& map, ClosureKind kind) {
  return static_cast<Index>(std::ranges::count(map.closures, kind, &LoopClosure::kind));
}

std::vector<Index> frames(const SlamMap& map) {
  std::vector<Index> values;
  for (const Session& session : map.sessions) values.push_back(session.frame.value);
  return values;
}

}  // namespace

TEST_SUITE("slam: several sessions") {
  TEST_CASE("a second session is found by GNSS, moved as a whole, and closed again along its way") {
    const DrivesRoundTheBlock drives(2);
    auto back_end = gnss_back_end(drives);
    drives.drive(back_end, 0);
    CHECK(back_end.counts().merges == 0);
    drives.drive(back_end, 1);
    const auto map = back_end.finish();
    CHECK(back_end.counts().merges == 1);
    CHECK(back_end.counts().failed_optimizations == 0);
    CHECK(frames(*map) == std::vector<Index>{0, 0});
    CHECK(count(*map, ClosureKind::merge) == 2);
    CHECK(count(*map, ClosureKind::direct) > 5);
    CHECK(inter_session_error(drives, *map, 0, 1) < 0.1);
    // Where odometry's frame lies now, by the newest keyframe.
    const Keyframe& newest = map->keyframes.back();
    CHECK(translation_error(newest.T_map_body, *back_end.T_map_odom() * newest.T_odom_body) < 1e-9);

    Index rechecked = 0;
    for (std::size_t i = 0; i < map->closures.size(); ++i) {
      const LoopClosure& closure = map->closures[i];
      CHECK(closure.from < closure.to);
      CHECK_FALSE(closure.sqrt_information.isZero(0));
      if (closure.kind == ClosureKind::merge) CHECK(closure.cause == -1);
      if (closure.cause < 0) continue;
      REQUIRE(closure.cause < to_index(i));
      const LoopClosure& cause = map->closures[static_cast<std::size_t>(closure.cause)];
      if (closure.kind == ClosureKind::direct) {
        CHECK(cause.kind == ClosureKind::merge);
        ++rechecked;
      } else {
        CHECK(cause.kind == ClosureKind::direct);
        CHECK(cause.to == closure.to);
      }
    }
    CHECK(rechecked > 0);
    for (std::size_t i = 0; i < map->closures.size(); ++i)  // the graph of closures is that of the map
      CHECK(back_end.closure_graph().connected(map->closures[i].from.value, map->closures[i].to.value));
    CHECK(back_end.closure_graph().edge_count() == to_index(map->closures.size()));
  }

  TEST_CASE("no pair of keyframes is measured twice") {
    const DrivesRoundTheBlock drives(3);
    auto back_end = gnss_back_end(drives);
    for (Index session = 0; session < 3; ++session) drives.drive(back_end, session);
    const auto map = back_end.finish();
    std::vector<std::pair<Index, Index>> pairs;
    for (const LoopClosure& closure : map->closures) pairs.emplace_back(closure.from.value, closure.to.value);
    std::ranges::sort(pairs);
    CHECK(std::ranges::adjacent_find(pairs) == pairs.end());
  }

  TEST_CASE("a third session is chained to those that its partners are connected with") {
    const DrivesRoundTheBlock drives(3);
    auto back_end = gnss_back_end(drives);
    for (Index session = 0; session < 3; ++session) drives.drive(back_end, session);
    const auto map = back_end.finish();
    CHECK(frames(*map) == std::vector<Index>{0, 0, 0});
    CHECK(count(*map, ClosureKind::chained) > 0);
    for (const LoopClosure& closure : map->closures)
      if (closure.kind == ClosureKind::chained) {
        CHECK(closure.from.value < 2 * per_session);  // never within the current session
        CHECK(closure.cause >= 0);
      }
    for (Index a = 0; a < 3; ++a)
      for (Index b = a + 1; b < 3; ++b) CHECK(inter_session_error(drives, *map, a, b) < 0.1);
  }

  TEST_CASE("chaining in the recheck can be left out, as the released code does") {
    const DrivesRoundTheBlock drives(3);
    auto back_end = gnss_back_end(drives, {.chain_in_recheck = false});
    for (Index session = 0; session < 3; ++session) drives.drive(back_end, session);
    for (const LoopClosure& closure : back_end.map().closures) {
      if (closure.kind != ClosureKind::chained) continue;
      const LoopClosure& direct = back_end.map().closures[static_cast<std::size_t>(closure.cause)];
      CHECK(direct.cause == -1);
    }
  }

  TEST_CASE("a saved map and a new session give what all sessions in one run give") {
    const DrivesRoundTheBlock drives(3);
    auto one_run = gnss_back_end(drives);
    drives.drive(one_run, 0);
    drives.drive(one_run, 1);
    const auto saved = one_run.finish();
    drives.drive(one_run, 2);
    const auto expected = one_run.finish();

    auto later = gnss_back_end(drives);
    later.load(*saved);
    drives.drive(later, 2);
    const auto map = later.finish();
    REQUIRE(map->closures.size() == expected->closures.size());
    for (std::size_t i = 0; i < map->closures.size(); ++i) {
      CHECK(map->closures[i].from == expected->closures[i].from);
      CHECK(map->closures[i].to == expected->closures[i].to);
      CHECK(map->closures[i].kind == expected->closures[i].kind);
      CHECK(map->closures[i].cause == expected->closures[i].cause);
    }
    CHECK(map->refusals.size() == expected->refusals.size());
    CHECK(frames(*map) == frames(*expected));
    CHECK(farthest_apart(*map, *expected) < 1e-6);
  }

  TEST_CASE("two maps that were made apart are joined by a session that knows both") {
    for (const bool earlier_first : {false, true}) {
      DrivesRoundTheBlock drives(3);
      UnmergedBackEnd a({}, drives.closer()), b({}, drives.closer());
      drives.drive(a, 0);
      drives.drive(b, 1);
      drives.place(2 * per_session + 10, (earlier_first ? 34 : per_session + 22));
      drives.place(2 * per_session + 20, (earlier_first ? per_session + 32 : 44));
      auto back_end = scripted_back_end(drives, {.min_travel = 0, .confirmations = 1});
      back_end.load(*a.finish());
      back_end.load(*b.finish());
      CHECK(frames(back_end.map()) == std::vector<Index>{0, 1});
      drives.drive(back_end, 2, false);
      const auto map = back_end.finish();
      CHECK(back_end.counts().merges == 2);
      CHECK(frames(*map) == std::vector<Index>{0, 0, 0});
      for (Index first = 0; first < 3; ++first)
        for (Index second = first + 1; second < 3; ++second)
          CHECK(inter_session_error(drives, *map, first, second) < 0.3);
      CHECK(map->keyframes[0].T_map_body.local(map->keyframes[0].T_odom_body).norm() < 1e-3);  // the first frame stays
    }
  }

  TEST_CASE("a place that nothing confirms leaves the frames apart, and is on record at the end") {
    DrivesRoundTheBlock drives(2);
    drives.place(per_session + 5, 17, SE3d(SO3d(), {1, 0, 0}));
    auto back_end = scripted_back_end(drives, {.min_travel = 0});
    drives.drive(back_end, 0, false);
    drives.drive(back_end, 1, false);
    CHECK(back_end.map().refusals.empty());
    const auto map = back_end.finish();
    CHECK(frames(*map) == std::vector<Index>{0, 1});
    CHECK(map->closures.empty());
    REQUIRE(map->refusals.size() == 1);
    CHECK(map->refusals[0].verdict == ClosureVerdict::unconfirmed);
    CHECK(map->refusals[0].kind == ClosureKind::merge);
    CHECK(back_end.counts().merges == 0);
  }

  TEST_CASE("a merge whose measurement is of unknown certainty holds by the anchor, or by what the recheck closes") {
    for (const bool anchored : {true, false}) {
      DrivesRoundTheBlock drives(2);
      drives.place(per_session + 10, 22, SE3d(SO3d::exp({0, 0, 0.03}), {0.8, -0.3, 0}));
      drives.blind = KeyframeId{per_session + 10};
      auto back_end =
          scripted_back_end(drives, {.min_travel = 0, .measurement = MergeMeasurement::scan, .confirmations = 1},
                            {.graph = {.anchor_joined_sessions = anchored}});
      drives.drive(back_end, 0);
      drives.drive(back_end, 1);
      const auto map = back_end.finish();
      CHECK(frames(*map) == std::vector<Index>{0, 0});
      CHECK(map->closures.front().sqrt_information.isZero(0));
      CHECK(inter_session_error(drives, *map, 0, 1) < (anchored ? 1.0 : 0.1));
      // Without the anchor nothing ties the sessions before the first closure: those poses stay as they were aligned.
      CHECK(back_end.counts().failed_optimizations == (anchored ? 0 : 1));
    }
  }

  TEST_CASE("the paper's alignment factor ties the sessions, and is an edge that chains go along") {
    for (const bool chained : {false, true}) {
      DrivesRoundTheBlock drives(3);
      drives.place(per_session + 10, 22, SE3d(SO3d::exp({0, 0, 0.003}), {0.08, -0.03, 0}));
      drives.place(2 * per_session + 1, per_session + 10);
      auto back_end = scripted_back_end(
          drives, {.min_travel = 0, .measurement = MergeMeasurement::submaps, .confirmations = 1},
          {.graph = {.anchor_joined_sessions = true}, .recheck_travel = 1e9, .chain_merges = chained});
      for (Index session = 0; session < 3; ++session) drives.drive(back_end, session);
      const auto map = back_end.finish();
      CHECK(back_end.counts().failed_optimizations == 0);
      CHECK(frames(*map) == std::vector<Index>{0, 0, 0});
      CHECK(count(*map, ClosureKind::merge) == 2);
      CHECK(back_end.closure_graph().connected(22, per_session + 10));
      // From the third session's merge with keyframe 60, edges lead on to the first session.
      const auto found = std::ranges::find_if(map->closures, [](const LoopClosure& closure) {
        return closure.kind == ClosureKind::chained && closure.from.value < per_session &&
               closure.to == KeyframeId{2 * per_session + 1};
      });
      REQUIRE((found != map->closures.end()) == chained);
      if (chained) CHECK(map->closures[static_cast<std::size_t>(found->cause)].kind == ClosureKind::merge);
    }
  }

  TEST_CASE("closures before a merge can be left out, as the released code does; those after it are not") {
    for (const bool before : {true, false}) {
      DrivesRoundTheBlock drives(2);
      drives.place(per_session + 37, 49);
      TruthCloser closer = drives.closer();
      closer.candidates.min_interval = seconds(3.0);  // a session closes loops with itself
      closer.candidates.min_keyframes = 0;
      closer.candidates.radius = 12;
      ScriptedBackEnd back_end({.recheck_travel = 1e9, .close_before_merge = before}, closer, ChainedCloser(),
                               MapMerger<ScriptedPlaces, ScriptedRegistration>({.min_travel = 0, .confirmations = 1},
                                                                               {drives.script}, {drives.script}));
      drives.drive(back_end, 0);
      const auto within = [&](Index session, Index end) {
        return std::ranges::count_if(back_end.map().closures, [&](const LoopClosure& closure) {
          return closure.cause < 0 && closure.kind == ClosureKind::direct &&
                 closure.to.value / per_session == session && closure.to.value % per_session < end;
        });
      };
      CHECK(within(0, per_session) > 0);  // nothing to be merged with
      drives.drive(back_end, 1);
      CHECK(back_end.counts().merges == 1);
      CHECK((within(1, 37) > 0) == before);
      CHECK(within(1, per_session) > within(1, 38));
    }
  }

  TEST_CASE("the recheck can pass over keyframes after one that was found") {
    const auto rechecked = [](Index pause) {
      DrivesRoundTheBlock drives(2);
      drives.place(per_session + 30, 42);
      auto back_end = scripted_back_end(drives, {.min_travel = 0, .confirmations = 1},
                                        {.recheck_travel = 0, .recheck_pause = pause});
      drives.drive(back_end, 0);
      drives.drive(back_end, 1);
      std::vector<Index> found;
      for (const LoopClosure& closure : back_end.map().closures)
        if (closure.kind == ClosureKind::direct && closure.cause >= 0) found.push_back(closure.to.value);
      return found;
    };
    const std::vector<Index> all = rechecked(0), some = rechecked(4);
    REQUIRE(some.size() > 1);
    CHECK(all.size() > 3 * some.size());
    CHECK(some[0] == all[0]);
    for (std::size_t i = 1; i < some.size(); ++i) CHECK(some[i] - some[i - 1] >= 5);
  }

  TEST_CASE("what a merge gives to do is spread over the keyframes that follow, and at the end all is done") {
    struct Run {
      std::vector<Index> alignments;  ///< that each keyframe of the second session caused, and the end
      std::vector<Index> rechecked;   ///< keyframes closed because of the merge
      double error = 0;
    };
    const auto run = [](Index found_at, Index max_alignments) {
      DrivesRoundTheBlock drives(2);
      drives.place(per_session + found_at, found_at + 12);
      auto back_end = scripted_back_end(drives, {.min_travel = 0, .confirmations = 1},
                                        {.recheck_travel = 0, .max_alignments = max_alignments});
      drives.drive(back_end, 0);
      back_end.begin_session("b");
      Run result;
      const auto count_from = [&](Index before) { result.alignments.push_back(back_end.counts().alignments - before); };
      for (Index i = 0; i < per_session; ++i) {
        const Index before = back_end.counts().alignments;
        back_end.add(test::keyframe_at(i, drives.odometry[static_cast<std::size_t>(per_session + i)]));
        count_from(before);
      }
      const Index before = back_end.counts().alignments;
      const auto map = back_end.finish();
      count_from(before);
      for (const LoopClosure& closure : map->closures)
        if (closure.kind == ClosureKind::direct && closure.cause >= 0) result.rechecked.push_back(closure.to.value);
      result.error = inter_session_error(drives, *map, 0, 1);
      return result;
    };
    const auto most_of_one = [](const Run& one) {
      return *std::max_element(one.alignments.begin(), one.alignments.end() - 1);
    };
    const Run at_once = run(20, 0), spread = run(20, BackEndOptions{}.max_alignments);
    CHECK(most_of_one(at_once) > 15);
    CHECK(most_of_one(spread) < 8);  // what is begun when the fourth is made is ended
    CHECK(spread.rechecked == at_once.rechecked);
    CHECK(spread.error < 0.1);
    const Run late = run(36, 1);  // too few keyframes follow
    CHECK(late.alignments.back() > 15);
    CHECK(late.rechecked == run(36, 0).rechecked);
  }

  TEST_CASE("without merging, sessions stay in frames of their own and close no loops with each other") {
    const DrivesRoundTheBlock drives(2);
    UnmergedBackEnd back_end({}, drives.closer());
    drives.drive(back_end, 0);
    drives.drive(back_end, 1);
    const auto map = back_end.finish();
    CHECK(frames(*map) == std::vector<Index>{0, 1});
    CHECK(map->closures.empty());
    for (const Keyframe& keyframe : map->keyframes)
      CHECK(keyframe.T_map_body.local(keyframe.T_odom_body).norm() < 1e-9);
  }

  TEST_CASE("a session without GNSS stays apart, and the others find each other past it") {
    const DrivesRoundTheBlock drives(3);
    auto back_end = gnss_back_end(drives);
    drives.drive(back_end, 0);
    drives.drive(back_end, 1, false);
    drives.drive(back_end, 2);
    const auto map = back_end.finish();
    CHECK(frames(*map) == std::vector<Index>{0, 1, 0});
    CHECK(inter_session_error(drives, *map, 0, 2) < 0.1);
    for (const LoopClosure& closure : map->closures)
      CHECK((closure.from.value < per_session || closure.from.value >= 2 * per_session));
  }

  TEST_CASE("by way of a pipeline the map is the same to the bit") {
    const DrivesRoundTheBlock drives(3);
    auto by_hand = gnss_back_end(drives);
    for (Index session = 0; session < 3; ++session) drives.drive(by_hand, session);
    const auto expected = by_hand.finish();
    const DrivesRoundTheBlock again(3);
    auto back_end = gnss_back_end(again);
    const Serial serial;
    Pipeline pipeline(back_end, serial, NoCallback{}, 2);
    for (Index session = 0; session < 3; ++session) again.drive(pipeline, session);
    pipeline.finish();
    const auto map = back_end.finish();
    REQUIRE(map->closures.size() == expected->closures.size());
    REQUIRE(map->keyframes.size() == expected->keyframes.size());
    for (std::size_t i = 0; i < map->keyframes.size(); ++i)
      CHECK(map->keyframes[i].T_map_body == expected->keyframes[i].T_map_body);
  }
}

TEST_SUITE("slam: several sessions, by default") {
  TEST_CASE("what the recheck finds is chained, so that keyframes are tied to both other sessions where they meet") {
    Index tied[2];
    for (const bool chained : {false, true}) {
      DrivesRoundTheBlock drives(3);
      drives.place(per_session + 20, 32);
      drives.place(2 * per_session + 35, per_session + 47);
      BackEndOptions options;
      if (!chained) options.chain_in_recheck = false;
      auto back_end = scripted_back_end(drives, {.min_travel = 0, .confirmations = 1}, options);
      for (Index session = 0; session < 3; ++session) drives.drive(back_end, session, false);
      std::vector<char> to_first(per_session), to_second(per_session);
      for (const LoopClosure& closure : back_end.map().closures) {
        if (closure.to.value < 2 * per_session) continue;
        const auto i = static_cast<std::size_t>(closure.to.value - 2 * per_session);
        (closure.from.value < per_session ? to_first : to_second)[i] = 1;
      }
      Index& both = tied[chained ? 1 : 0] = 0;
      for (std::size_t i = 0; i < to_first.size(); ++i) both += to_first[i] != 0 && to_second[i] != 0 ? 1 : 0;
    }
    MESSAGE("keyframes tied to both: ", tied[0], " -> ", tied[1]);
    CHECK(tied[1] >= tied[0] + 12);
  }

  TEST_CASE("a session, and a frame that is found later, are carried to where the place says") {
    DrivesRoundTheBlock drives(3);
    drives.place(2 * per_session + 10, 34);
    drives.place(2 * per_session + 20, per_session + 32);
    TruthCloser closer = drives.closer();
    closer.reach = 0;  // no scan fits: nothing but the places moves the sessions
    ScriptedBackEnd back_end({.graph = {.anchor_joined_sessions = true}, .close_before_merge = false}, closer,
                             ChainedCloser(),
                             MapMerger<ScriptedPlaces, ScriptedRegistration>(
                                 {.min_travel = 0, .measurement = MergeMeasurement::scan, .confirmations = 1},
                                 {drives.script}, {drives.script}));
    for (Index session = 0; session < 3; ++session) drives.drive(back_end, session, false);
    CHECK(back_end.counts().merges == 2);
    const SlamMap& map = back_end.map();
    CHECK(frames(map) == std::vector<Index>{0, 0, 0});
    for (const auto& [from, to] : {std::pair{34, 2 * per_session + 10}, {per_session + 32, 2 * per_session + 20}}) {
      const SE3d T_from_to = map.keyframes[static_cast<std::size_t>(from)].T_map_body.inverse() *
                             map.keyframes[static_cast<std::size_t>(to)].T_map_body;
      CHECK(translation_error(drives.between(from, to), T_from_to) < 1e-3);
      CHECK(test::rotation_error(drives.between(from, to), T_from_to) < 1e-3);
    }
  }
}

}  // namespace chainslam
