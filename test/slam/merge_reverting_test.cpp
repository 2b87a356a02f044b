#include <doctest/doctest.h>

#include <algorithm>
#include <memory>
#include <vector>

#include "chainslam/slam/back_end.hpp"
#include "slam/block_drives.hpp"
#include "slam/scripted.hpp"

namespace chainslam {
namespace {

using test::DrivesRoundTheBlock;
using test::inter_session_error;
using test::per_session;
using test::ScriptedPlaces;
using test::ScriptedRegistration;
using test::TruthCloser;

/// Place recognition by GNSS. Registration measures exactly, but at chosen keyframes takes them to be elsewhere: they
/// look like other places, which lie to each other as the right ones do.
struct MisledPlaces {
  const DrivesRoundTheBlock* drives;
  std::vector<Index> misled{};
  SE3d T_world_believed = test::shift(0, 300, 0);
  GnssCandidates candidates = GnssCandidates({.max_count = 1});

  [[nodiscard]] std::vector<KeyframeId> find(const SlamMap& map, KeyframeId query) {
    *drives->script = {};
    return scripted(candidates.find(map, query), query);
  }
  [[nodiscard]] std::vector<KeyframeId> misplaced(const SlamMap& map, KeyframeId query) {
    return scripted(candidates.misplaced(map, query), query);
  }

 private:
  [[nodiscard]] std::vector<KeyframeId> scripted(const std::vector<KeyframeId>& found, KeyframeId query) const {
    const auto truth = [&](KeyframeId id) { return drives->truth[static_cast<std::size_t>(id.value)]; };
    const bool wrong = std::ranges::find(misled, query.value) != misled.end();
    for (const KeyframeId id : found) {
      drives->script->proposed.push_back(drives->script->places.size());
      drives->script->places.push_back(
          {query.value, id.value, truth(id).inverse() * (wrong ? T_world_believed : SE3d()) * truth(query)});
    }
    return found;
  }
};

using MisledBackEnd = BackEnd<TruthCloser, ChainedCloser, MapMerger<MisledPlaces, ScriptedRegistration>>;
using ScriptBackEnd = BackEnd<TruthCloser, ChainedCloser, MapMerger<ScriptedPlaces, ScriptedRegistration>>;

MisledBackEnd misled_back_end(const DrivesRoundTheBlock& drives, std::vector<Index> misled, MergeOptions merging = {}) {
  merging.measurement = MergeMeasurement::submaps;
  return MisledBackEnd(
      {}, drives.closer(), ChainedCloser(),
      MapMerger<MisledPlaces, ScriptedRegistration>(merging, {&drives, std::move(misled)}, {drives.script}));
}

/// The first keyframes of a session, a number of metres along its way.
std::vector<Index> first_of(Index session, Index keyframes) {
  std::vector<Index> first;
  for (Index i = 0; i < keyframes; ++i) first.push_back(session * per_session + i);
  return first;
}

Index verdicts(const std::vector<LoopClosure>& closures, ClosureVerdict verdict) {
  return to_index(std::ranges::count(closures, verdict, &LoopClosure::verdict));
}

std::vector<Index> frames_of(const SlamMap& map) {
  std::vector<Index> values;
  for (const Session& session : map.sessions) values.push_back(session.frame.value);
  return values;
}

/// That no session lies anywhere but where its closures have it, and all that was reverted is on record.
void check_together(const DrivesRoundTheBlock& drives, const SlamMap& map) {
  const Index sessions = to_index(map.sessions.size());
  CHECK(frames_of(map) == std::vector<Index>(map.sessions.size(), 0));
  for (Index a = 0; a < sessions; ++a)
    for (Index b = a + 1; b < sessions; ++b) CHECK(inter_session_error(drives, map, a, b) < 0.15);
}

}  // namespace

TEST_SUITE("slam: merges that are reverted") {
  TEST_CASE("a merge into another place that looks the same is reverted when places and fixes say otherwise") {
    const DrivesRoundTheBlock drives(2);
    auto back_end = misled_back_end(drives, first_of(1, 10));  // before there are fixes enough to see it
    drives.drive(back_end, 0);
    drives.drive(back_end, 1);
    const auto map = back_end.finish();
    CHECK(back_end.counts().merges == 2);
    CHECK(back_end.counts().reverted == 1);
    check_together(drives, *map);
    CHECK(verdicts(map->closures, ClosureVerdict::reverted) == 2);
    CHECK(map->closures.front().verdict == ClosureVerdict::reverted);
    CHECK(verdicts(map->closures, ClosureVerdict::inconsistent) == 0);
    for (const LoopClosure& closure : map->closures)  // what was reverted is no edge that chains go along
      CHECK(back_end.closure_graph().connected(closure.from.value, closure.to.value) == closure.is_factor());
  }

  TEST_CASE("without fixes that are asked, it stays: the same closures, but for the decision") {
    const DrivesRoundTheBlock drives(2);
    MergeOptions deaf;
    deaf.fixes.max_difference = 0;
    auto back_end = misled_back_end(drives, first_of(1, 10), deaf);
    drives.drive(back_end, 0);
    drives.drive(back_end, 1);
    const auto map = back_end.finish();
    CHECK(back_end.counts().reverted == 0);
    CHECK(inter_session_error(drives, *map, 0, 1) > 100);
  }

  TEST_CASE("places that agree are not joined where the fixes along both ways contradict them, and block none") {
    const DrivesRoundTheBlock drives(2);
    std::vector<Index> misled;
    for (Index i = 15; i < 28; ++i) misled.push_back(per_session + i);
    MergeOptions merging;
    merging.min_place_distance =
        14;  // so that the first two right places lie before the wrong ones, too near each other
    auto back_end = misled_back_end(drives, misled, merging);
    drives.drive(back_end, 0);
    back_end.begin_session("b");
    for (Index i = 0; i < per_session; ++i) {
      const auto at = static_cast<std::size_t>(per_session + i);
      back_end.add(test::keyframe_at(i, drives.odometry[at]));
      // No fixes of the first keyframes: no places are tried there.
      if (i >= 3) back_end.add(test::fix_at(Timestamp::from_seconds(i), drives.truth[at].translation()));
      if (i == 14) CHECK(back_end.counts().merges == 1);
    }
    const auto map = back_end.finish();
    CHECK(back_end.counts().reverted == 0);
    check_together(drives, *map);
  }

  TEST_CASE("wrong places that agree while fixes contradict them are refused by name; right ones then join") {
    const DrivesRoundTheBlock drives(2);
    MergeOptions merging;
    merging.confirmations = 3;  // the first attempts do not suffice before the fixes do
    auto back_end = misled_back_end(drives, first_of(1, 16), merging);
    drives.drive(back_end, 0);
    drives.drive(back_end, 1);
    const auto map = back_end.finish();
    CHECK(verdicts(map->refusals, ClosureVerdict::against_fixes) == 3);
    CHECK(back_end.counts().merges == 1);
    CHECK(back_end.counts().reverted == 0);
    check_together(drives, *map);
  }

  TEST_CASE("a wrong merge in a map that was saved is reverted by a session that visits both of its sides") {
    const DrivesRoundTheBlock drives(3);
    auto first = misled_back_end(drives, first_of(1, per_session));
    drives.drive(first, 0);
    first.begin_session("b");
    for (Index i = 0; i < per_session; ++i) {
      const auto at = static_cast<std::size_t>(per_session + i);
      first.add(test::keyframe_at(i, drives.odometry[at]));
      // A receiver that finds itself where the place that looks the same is, until both have been joined.
      if (i < 8) first.add(test::fix_at(Timestamp::from_seconds(i), drives.truth[at].translation()));
    }
    SlamMap saved = *first.finish();
    REQUIRE(first.counts().merges == 1);
    for (Index i = 0; i < per_session; ++i) {  // fixes that came later, such as from another receiver's record
      const auto at = static_cast<std::size_t>(per_session + i);
      saved.keyframes[at].gnss = test::fix_at(saved.keyframes[at].time, drives.truth[at].translation());
    }
    auto back_end = misled_back_end(drives, {});
    back_end.load(saved);
    CHECK(frames_of(back_end.map()) == std::vector<Index>{0, 0});
    drives.drive(back_end, 2);
    const auto map = back_end.finish();
    CHECK(back_end.counts().reverted == 1);
    CHECK(verdicts(map->closures, ClosureVerdict::reverted) == 2);
    check_together(drives, *map);
  }

  TEST_CASE("a saved frame that only rejected closures hold together is parted when it is loaded, and joined anew") {
    DrivesRoundTheBlock drives(2);
    auto first = misled_back_end(drives, {});
    drives.drive(first, 0);
    drives.drive(first, 1);
    SlamMap saved = *first.finish();
    REQUIRE(frames_of(saved) == std::vector<Index>{0, 0});
    Index between = 0;
    for (LoopClosure& closure : saved.closures)
      if (closure.from.value < per_session && closure.to.value >= per_session) {
        closure.verdict = ClosureVerdict::inconsistent;
        ++between;
      }
    auto back_end = misled_back_end(drives, {});
    back_end.load(saved);
    const SlamMap& parted = back_end.map();
    CHECK(back_end.counts().reverted == 1);
    CHECK(frames_of(parted) == std::vector<Index>{0, 1});
    CHECK(verdicts(parted.closures, ClosureVerdict::reverted) == between);
    for (Index i = per_session; i < 2 * per_session; ++i) {
      const Keyframe& one = parted.keyframes[static_cast<std::size_t>(i)];
      CHECK(one.T_map_body.local(one.T_odom_body).norm() < 0.5);  // closures of its own may have straightened it
    }
    CHECK(back_end.counts().last.ok());
    CHECK(back_end.smoother().count<PriorFactor<SE3d>>() >= 2);
  }

  TEST_CASE("sessions that share a ten metres' stretch are joined by one place, if fixes and scans agree with it") {
    for (const Index supporting_scans : {3, 0, 20}) {
      DrivesRoundTheBlock drives(2);
      for (Index i = 0; i < 2 * per_session; ++i) {  // along one line: the second begins where the first one ends
        const auto at = static_cast<std::size_t>(i);
        const Index first = i < per_session ? 0 : per_session;
        drives.truth[at] = test::shift(2 * (i < per_session ? i : i - 3), i < per_session ? 0 : 0.7, 0);
        drives.odometry[at] = drives.truth[static_cast<std::size_t>(first)].inverse() * drives.truth[at];
      }
      MergeOptions merging;
      merging.supporting_scans = supporting_scans;
      merging.measurement = MergeMeasurement::refined;
      MisledPlaces places{&drives};
      places.candidates = GnssCandidates({.radius = 4, .max_count = 1});
      TruthCloser closer = drives.closer();
      MisledBackEnd back_end({}, closer, ChainedCloser(),
                             MapMerger<MisledPlaces, ScriptedRegistration>(merging, places, {drives.script}));
      drives.drive(back_end, 0);
      drives.drive(back_end, 1);
      const auto map = back_end.finish();
      const auto merges = std::ranges::count(map->closures, ClosureKind::merge, &LoopClosure::kind);
      CHECK(merges == (supporting_scans == 3 ? 1 : 0));
      CHECK(frames_of(*map) == std::vector<Index>{0, supporting_scans == 3 ? 0 : 1});
      if (supporting_scans == 3) check_together(drives, *map);
    }
  }

  TEST_CASE("sessions that lie on each other already are joined all the same") {
    DrivesRoundTheBlock drives(2);
    drives.odometry = drives.truth;
    auto back_end = misled_back_end(drives, {});
    drives.drive(back_end, 0);
    drives.drive(back_end, 1);
    const auto map = back_end.finish();
    CHECK(back_end.counts().merges == 1);
    check_together(drives, *map);
  }

  TEST_CASE("sessions whose frames lie far from each other and are turned are joined in one step, to where they were") {
    for (const double turn : {0.5, 1.6, 3.0}) {
      DrivesRoundTheBlock drives(2);
      const SE3d T_odom_odom(SO3d::exp({0, 0, turn}), {400, -300, 5});
      for (Index i = per_session; i < 2 * per_session; ++i) {
        SE3d& pose = drives.odometry[static_cast<std::size_t>(i)];
        pose = T_odom_odom * pose;
      }
      auto back_end = misled_back_end(drives, {});
      drives.drive(back_end, 0);
      back_end.begin_session("b");
      for (Index i = 0; back_end.counts().merges == 0 && i < per_session; ++i) {
        const auto at = static_cast<std::size_t>(per_session + i);
        back_end.add(test::keyframe_at(i, drives.odometry[at]));
        back_end.add(test::fix_at(Timestamp::from_seconds(i), drives.truth[at].translation()));
      }
      REQUIRE(back_end.counts().merges == 1);
      CHECK(back_end.counts().failed_optimizations == 0);
      const SlamMap& map = back_end.map();
      const SE3d T_world_map = drives.truth[0] * map.keyframes[0].T_map_body.inverse();
      for (const Keyframe& one : map.keyframes)  // half a metre of drift, but no turn
        CHECK(test::translation_error(drives.truth[static_cast<std::size_t>(one.id.value)],
                                      T_world_map * one.T_map_body) < 1.5);
      // Nothing had to be pulled: what closes along the joined session agrees with where it was put.
      for (const LoopClosure& closure : map.closures) CHECK(closure.verdict == ClosureVerdict::accepted);
    }
  }

  TEST_CASE("two maps are joined by a session that is in both by turns: what speaks for one does not undo the other") {
    DrivesRoundTheBlock drives(3);
    BackEnd<TruthCloser, ChainedCloser, NoMerging> a({}, drives.closer()), b({}, drives.closer());
    drives.drive(a, 0);
    drives.drive(b, 1);
    const Index third = 2 * per_session;
    drives.place(third + 2, 26);
    drives.place(third + 5, per_session + 17);
    drives.place(third + 9, 33);
    drives.place(third + 12, per_session + 24);
    ScriptBackEnd back_end(
        {}, drives.closer(), ChainedCloser(),
        MapMerger<ScriptedPlaces, ScriptedRegistration>({.min_travel = 0}, {drives.script}, {drives.script}));
    back_end.load(*a.finish());
    back_end.load(*b.finish());
    drives.drive(back_end, 2, false);
    const auto map = back_end.finish();
    CHECK(back_end.counts().merges == 2);
    check_together(drives, *map);
    CHECK(verdicts(map->refusals, ClosureVerdict::unconfirmed) == 0);
  }
}

}  // namespace chainslam
