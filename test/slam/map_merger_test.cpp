#include "chainslam/slam/map_merger.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <memory>
#include <optional>
#include <vector>

#include "slam/scripted.hpp"
#include "slam/street.hpp"
#include "support/property.hpp"

namespace chainslam {
namespace {

using test::for_all;
using test::Place;
using test::random_motion;
using test::Script;
using test::ScriptedPlaces;
using test::ScriptedRegistration;
using test::TruthCloser;

using Merger = MapMerger<ScriptedPlaces, ScriptedRegistration>;

constexpr Index each = 40;  ///< keyframes of a session, two metres apart

/// Sessions along one street, each in a frame of its own.
struct Sessions {
  SlamMap map;
  std::vector<SE3d> T_world_frame;
  std::shared_ptr<Script> script = std::make_shared<Script>();
  TruthCloser closer;

  explicit Sessions(int count, Rng rng = Rng(5)) {
    std::vector<SE3d> truth;
    for (int session = 0; session < count; ++session) {
      const SessionId id{session};
      map.sessions.push_back({id, {}, session * each, each, id, {}, {}});
      T_world_frame.push_back(session == 0 ? SE3d() : random_motion(rng, 30, 1));
      for (Index i = 0; i < each; ++i) {
        truth.emplace_back(SO3d::exp({0, 0, 0.01 * i}), Eigen::Vector3d(2 * i, session, 0));
        Keyframe keyframe = test::keyframe_at(i, T_world_frame.back().inverse() * truth.back());
        keyframe.id = KeyframeId{session * each + i};
        keyframe.session = id;
        map.keyframes.push_back(keyframe);
      }
    }
    closer.truth = std::make_shared<const std::vector<SE3d>>(std::move(truth));
  }

  /// Place recognition will find keyframe `candidate` for the query: rightly, but for the error.
  Place& place(Index query, Index candidate, const SE3d& error = {}) {
    const SE3d T = (*closer.truth)[static_cast<std::size_t>(candidate)].inverse() *
                   (*closer.truth)[static_cast<std::size_t>(query)] * error;
    script->places.push_back({query, candidate, T});
    return script->places.back();
  }

  [[nodiscard]] Merger merger(const MergeOptions& options) const {
    return Merger(options, ScriptedPlaces{script}, ScriptedRegistration{script});
  }

  /// What the attempts for the keyframes of a session gave, one after the other.
  [[nodiscard]] std::vector<std::vector<LoopClosure>> attempts(Merger& merger, Index session = 1) {
    std::vector<std::vector<LoopClosure>> tried;
    for (Index i = 0; i < each; ++i) tried.push_back(merger.attempt(map, KeyframeId{session * each + i}, closer));
    return tried;
  }
};

/// Verdicts in the order of the attempts, and the number of attempts until the frames were joined, -1 if they were not.
struct Outcome {
  std::vector<ClosureVerdict> verdicts;
  Index joined_at = -1;
  std::vector<LoopClosure> accepted;

  explicit Outcome(const std::vector<std::vector<LoopClosure>>& attempts) {
    for (std::size_t i = 0; i < attempts.size(); ++i) {
      for (const LoopClosure& closure : attempts[i]) {
        CHECK(closure.kind == ClosureKind::merge);
        verdicts.push_back(closure.verdict);
        if (closure.verdict != ClosureVerdict::accepted) continue;
        if (joined_at < 0) joined_at = to_index(i);
        accepted.push_back(closure);
      }
      if (joined_at >= 0) break;
    }
  }
};

/// The places of a script, each with its pose as a guess.
struct GuessedPlaces : ScriptedPlaces {
  [[nodiscard]] std::optional<SE3d> guess(KeyframeId from, KeyframeId to) const {
    for (const Place& place : script->places)
      if (place.candidate == from.value && place.query == to.value) return place.T_candidate_query;
    return std::nullopt;
  }
};

using Verdicts = std::vector<ClosureVerdict>;
constexpr MergeOptions merge_as_in_paper{.min_travel = 0, .confirmations = 1};
constexpr MergeOptions unrefined{.min_travel = 0, .measurement = MergeMeasurement::submaps};
const SE3d far_off(SO3d(), {5, 0, 0});

}  // namespace

TEST_SUITE("slam/map_merger") {
  TEST_CASE("with one confirmation the first accepted place joins the frames, as in the paper") {
    Sessions sessions(2);
    sessions.place(45, 6, SE3d(SO3d::exp({0, 0, 0.05}), {0.5, 0.2, 0}));
    Merger merger = sessions.merger(merge_as_in_paper);
    const Outcome outcome(sessions.attempts(merger));
    REQUIRE(outcome.accepted.size() == 1);
    CHECK(outcome.joined_at == 5);
    const LoopClosure& closure = outcome.accepted.front();
    CHECK(closure.from == KeyframeId{6});
    CHECK(closure.to == KeyframeId{45});
    CHECK(closure.inlier_ratio == 0.4);
    // Refined: the closer measures exactly, place recognition was half a metre off.
    const SE3d T_world_map =
        sessions.map.keyframes[6].T_map_body * closure.T_from_to * sessions.map.keyframes[45].T_map_body.inverse();
    CHECK(sessions.T_world_frame[1].local(T_world_map).norm() < 1e-9);
    CHECK_FALSE(closure.sqrt_information.isZero(0));
    CHECK(merger.withdraw().empty());
  }

  TEST_CASE("a candidate that comes with a guess is aligned from it, and registration without a guess is not asked") {
    Sessions sessions(2);
    sessions.place(45, 6, far_off);
    sessions.place(52, 13);
    sessions.place(46, 39);  // 66 m away: the closer refuses it
    MapMerger<GuessedPlaces, ScriptedRegistration> merger({.min_travel = 0}, GuessedPlaces{{sessions.script}},
                                                          ScriptedRegistration{sessions.script});
    std::vector<std::vector<LoopClosure>> tried;
    for (Index i = 0; i < each; ++i)
      tried.push_back(merger.attempt(sessions.map, KeyframeId{each + i}, sessions.closer));
    const Outcome outcome(tried);
    CHECK(outcome.verdicts ==
          Verdicts{ClosureVerdict::too_few_inliers, ClosureVerdict::accepted, ClosureVerdict::accepted});
    CHECK(outcome.joined_at == 12);
    CHECK(sessions.script->registered == 0);
    REQUIRE(!sessions.closer.asked->empty());
    CHECK(sessions.closer.asked->front().guess == sessions.script->places.front().T_candidate_query);
  }

  TEST_CASE("the registration's own pose can be the measurement: the paper's alignment factor, lambda e I") {
    Sessions sessions(2);
    const Place place = sessions.place(45, 6, far_off);
    sessions.script->places.back().inlier_rmse = 0.5;
    MergeOptions options = unrefined;
    options.confirmations = 1;
    options.lambda = 4e-4;
    Merger merger = sessions.merger(options);
    const Outcome outcome(sessions.attempts(merger));
    REQUIRE(outcome.accepted.size() == 1);
    const LoopClosure& closure = outcome.accepted.front();
    CHECK(closure.T_from_to == place.T_candidate_query);
    CHECK(closure.mean_squared_error == 0.25);
    CHECK((closure.sqrt_information - 100 * SqrtInformation<6>::Identity()).norm() < 1e-9);  // 1 / sqrt(4e-4 0.25)
    CHECK(sessions.closer.asked->empty());
  }

  TEST_CASE("as in the released code, the scan measures the closure if it can, and else nothing does") {
    for (const bool seen : {true, false}) {
      Sessions sessions(2);
      const Place place = sessions.place(45, 6, far_off);
      if (!seen) sessions.closer.reach = 0;
      Merger merger = sessions.merger({.min_travel = 0, .measurement = MergeMeasurement::scan, .confirmations = 1});
      const Outcome outcome(sessions.attempts(merger));
      REQUIRE(outcome.accepted.size() == 1);
      const LoopClosure& closure = outcome.accepted.front();
      CHECK((closure.T_from_to == place.T_candidate_query) == !seen);
      CHECK(closure.sqrt_information.isZero(0) == !seen);
      REQUIRE(sessions.closer.asked->size() == 1);
      CHECK(sessions.closer.asked->front().guess == place.T_candidate_query);
    }
  }

  TEST_CASE("an attempt tries one candidate, and the next keyframes' attempts the others, unless it may try all") {
    for (const Index at_once : {MergeOptions{}.max_registrations, 2, 0}) {
      CAPTURE(at_once);
      Sessions sessions(2);
      for (const Index candidate : {20, 30}) sessions.place(45, candidate).status = GlobalAlignStatus::no_consensus;
      sessions.place(45, 6);
      sessions.place(46, 7);  // not looked for while others wait
      MergeOptions options = merge_as_in_paper;
      options.max_registrations = at_once;
      Merger merger = sessions.merger(options);
      const auto attempts = sessions.attempts(merger);
      const Outcome outcome(attempts);
      CHECK(attempts[5].size() == static_cast<std::size_t>(at_once == 0 ? 3 : at_once));
      CHECK(outcome.joined_at == (at_once == 0 ? 5 : at_once == 1 ? 7 : 6));
      CHECK(outcome.verdicts ==
            Verdicts{ClosureVerdict::not_converged, ClosureVerdict::not_converged, ClosureVerdict::accepted});
      REQUIRE(outcome.accepted.size() == 1);
      CHECK(outcome.accepted.front().to == KeyframeId{45});
      CHECK(outcome.accepted.front().from == KeyframeId{6});
    }
  }

  TEST_CASE("candidates that wait are dropped once their frame is joined, and when the session ends") {
    Sessions sessions(2);
    sessions.place(45, 6);
    sessions.place(45, 20);
    Merger merger = sessions.merger(merge_as_in_paper);
    CHECK(Outcome({merger.attempt(sessions.map, KeyframeId{45}, sessions.closer)}).joined_at == 0);
    CHECK_FALSE(merger.is_unfinished());
    sessions.place(48, 9).status = GlobalAlignStatus::no_consensus;
    sessions.place(48, 20);
    CHECK(merger.attempt(sessions.map, KeyframeId{48}, sessions.closer).size() == 1);
    CHECK(merger.is_unfinished());
    CHECK(merger.withdraw().empty());
    CHECK_FALSE(merger.is_unfinished());
  }

  TEST_CASE("attempts can be a period of time apart") {
    Sessions sessions(2);
    for (const Index query : {45, 48, 50}) sessions.place(query, query - 39);
    MergeOptions options = unrefined;
    options.confirmations = 9;
    options.min_period = 4.5;  // keyframes are a second apart
    Merger merger = sessions.merger(options);
    CHECK(Outcome(sessions.attempts(merger)).verdicts.empty());
    CHECK(merger.withdraw().size() == 2);
    options.min_period = 5.5;
    Merger rarer = sessions.merger(options);
    CHECK(Outcome(sessions.attempts(rarer)).verdicts.empty());
    CHECK(rarer.withdraw().size() == 1);
  }

  TEST_CASE("two places that agree join the frames; the first waits for the second, and the newest comes last") {
    Sessions sessions(2);
    sessions.place(45, 6);
    sessions.place(60, 19);
    Merger merger = sessions.merger({.min_travel = 0});
    const auto attempts = sessions.attempts(merger);
    CHECK(attempts[5].empty());
    const Outcome outcome(attempts);
    CHECK(outcome.joined_at == 20);
    REQUIRE(outcome.accepted.size() == 2);
    CHECK(outcome.accepted[0].to == KeyframeId{45});
    CHECK(outcome.accepted[1].to == KeyframeId{60});
    CHECK(merger.withdraw().empty());
  }

  TEST_CASE("places that contradict each other never join, however many; at the end they are refusals") {
    Sessions sessions(2);
    for (Index i = 0; i < 10; ++i)  // each by itself shifts the frame 4 m farther: more than 2 m and 2 % of the way
      sessions.place(40 + 4 * i, 2 * i, SE3d(SO3d(), {4.0 * i, 0, 0}));
    Merger merger = sessions.merger(unrefined);
    CHECK(Outcome(sessions.attempts(merger)).verdicts.empty());
    const std::vector<LoopClosure> refused = merger.withdraw();
    REQUIRE(refused.size() == 10);
    for (std::size_t i = 0; i < refused.size(); ++i) {
      CHECK(refused[i].verdict == ClosureVerdict::unconfirmed);
      CHECK(refused[i].to == KeyframeId{40 + 4 * static_cast<Index>(i)});
    }
    CHECK(merger.withdraw().empty());
  }

  TEST_CASE("two places agree as far as the path between them can be trusted") {
    const auto joined = [](const SE3d& error, Index second, const MergeOptions& options) {
      Sessions sessions(2);
      sessions.place(45, 6);
      sessions.place(second, 19, error);
      Merger merger = sessions.merger(options);
      return Outcome(sessions.attempts(merger)).joined_at >= 0;
    };
    const auto shift = [](double x) { return SE3d(SO3d(), {x, 0, 0}); };
    MergeOptions options = unrefined;
    options.agree_per_metre = 0.05;  // 30 m from 45 to 60: 2 + 1.5 m
    CHECK(joined(shift(3.4), 60, options));
    CHECK_FALSE(joined(shift(3.6), 60, options));
    CHECK(joined(shift(3.6), 63, options));
    CHECK(joined(SE3d(SO3d::exp({0, 0, 0.09}), {0, 0, 0}), 60, options));
    CHECK_FALSE(joined(SE3d(SO3d::exp({0, 0, 0.11}), {0, 0, 0}), 60, options));
  }

  TEST_CASE("what a wrong place waits for does not come, and the right ones that follow do without it") {
    Sessions sessions(2);
    sessions.place(42, 6, SE3d(SO3d(), {9, 0, 0}));
    sessions.place(50, 9);
    sessions.place(60, 19);
    Merger merger = sessions.merger(unrefined);
    const Outcome outcome(sessions.attempts(merger));
    CHECK(outcome.joined_at == 20);
    CHECK(outcome.verdicts ==
          Verdicts{ClosureVerdict::unconfirmed, ClosureVerdict::accepted, ClosureVerdict::accepted});
  }

  TEST_CASE("places too near each other on the path do not confirm each other") {
    Sessions sessions(2);
    for (const Index query : {45, 46, 49, 50}) sessions.place(query, query - 39);
    Merger merger = sessions.merger(
        {.min_travel = 0, .min_place_distance = 9.9});  // the first and the last: 10 m, but for rounding
    const Outcome outcome(sessions.attempts(merger));
    CHECK(outcome.joined_at == 10);
    REQUIRE(outcome.accepted.size() == 2);
    CHECK(outcome.accepted[0].to == KeyframeId{45});

    Sessions others(2);  // 5 m, 5 m and 5 m apart: three that keep their distance are not among them
    for (const Index query : {45, 48, 51, 53}) others.place(query, query - 39);
    Merger three = others.merger({.min_travel = 0, .confirmations = 3, .min_place_distance = 10});
    CHECK(Outcome(others.attempts(three)).accepted.empty());
    CHECK(three.withdraw().size() == 4);
  }

  TEST_CASE("places in different frames do not confirm each other") {
    Sessions sessions(3);
    sessions.place(85, 6);
    sessions.place(100, 40 + 19);
    Merger merger = sessions.merger(unrefined);
    CHECK(Outcome(sessions.attempts(merger, 2)).joined_at == -1);
    CHECK(merger.withdraw().size() == 2);
    CHECK(Outcome(sessions.attempts(merger, 2)).joined_at == -1);
    sessions.map.sessions[1].frame = SessionId{0};  // now they are one
    for (Index i = 40; i < 80; ++i) {
      SE3d& T_map_body = sessions.map.keyframes[static_cast<std::size_t>(i)].T_map_body;
      T_map_body = sessions.T_world_frame[1] * T_map_body;
    }
    (void)merger.withdraw();
    CHECK(Outcome(sessions.attempts(merger, 2)).joined_at == 20);
  }

  TEST_CASE("a place that is not found, or of which too little is, is refused by name") {
    const auto verdicts = [](auto&& change, MergeOptions options) {
      Sessions sessions(2);
      change(sessions.place(45, 6));
      options.confirmations = 1;
      Merger merger = sessions.merger(options);
      return Outcome(sessions.attempts(merger)).verdicts;
    };
    CHECK(verdicts([](Place&) {}, unrefined) == Verdicts{ClosureVerdict::accepted});
    for (const auto status :
         {GlobalAlignStatus::too_few_points, GlobalAlignStatus::too_few_matches, GlobalAlignStatus::no_consensus})
      CHECK(verdicts([&](Place& place) { place.status = status; }, unrefined) ==
            Verdicts{ClosureVerdict::not_converged});
    CHECK(verdicts([](Place& place) { place.fitness = 0.149; }, unrefined) == Verdicts{ClosureVerdict::low_fitness});
    CHECK(verdicts([](Place& place) { place.fitness = std::nan(""); }, unrefined) ==
          Verdicts{ClosureVerdict::low_fitness});
    // What has asked the submaps themselves is not asked how many features agree.
    CHECK(verdicts(
              [](Place& place) {
                place.verified = true;
                place.fitness = place.putative_ratio = 0.01;
              },
              unrefined) == Verdicts{ClosureVerdict::accepted});
    CHECK(verdicts([](Place& place) { place.status = GlobalAlignStatus::refused; }, unrefined) ==
          Verdicts{ClosureVerdict::high_residual});
    MergeOptions released = unrefined;
    released.min_putative = 0.5;
    CHECK(verdicts([](Place&) {}, released) == Verdicts{ClosureVerdict::low_fitness});
    CHECK(verdicts([](Place& place) { place.putative_ratio = 0.5; }, released) == Verdicts{ClosureVerdict::accepted});
    released = unrefined;
    released.min_source_fitness = 0.5;
    CHECK(verdicts([](Place& place) { place.source_fitness = 0.49; }, released) ==
          Verdicts{ClosureVerdict::low_fitness});
    CHECK(verdicts([](Place& place) { place.source_fitness = 0.5; }, released) == Verdicts{ClosureVerdict::accepted});
  }

  TEST_CASE("a place that the closer does not see again is refused with the closer's reason") {
    Sessions sessions(2);
    sessions.closer.reach = 0.1;
    sessions.place(45, 6);
    Merger merger = sessions.merger(merge_as_in_paper);
    CHECK(Outcome(sessions.attempts(merger)).verdicts == Verdicts{ClosureVerdict::too_few_inliers});
  }

  TEST_CASE("frames that already lie on each other are not joined if that is asked for, as in the released code") {
    const auto verdicts = [](double metres, double radians, const MergeOptions& options) {
      Sessions sessions(2);
      // Moves session 1's frame to where it is but for this.
      const SE3d T_frame = SE3d(SO3d::exp({0, 0, radians}), {metres, 0, 0});
      for (Index i = 40; i < 80; ++i)
        sessions.map.keyframes[static_cast<std::size_t>(i)].T_map_body =
            T_frame.inverse() * (*sessions.closer.truth)[static_cast<std::size_t>(i)];
      sessions.place(45, 6);
      Merger merger = sessions.merger(options);
      return Outcome(sessions.attempts(merger)).verdicts;
    };
    MergeOptions released = merge_as_in_paper;
    released.min_translation = 1;
    released.min_rotation = 0.035;
    CHECK(verdicts(0.9, 0.03, released) == Verdicts{ClosureVerdict::implausible});
    CHECK(verdicts(1.1, 0.03, released) == Verdicts{ClosureVerdict::accepted});
    CHECK(verdicts(0.9, 0.04, released) == Verdicts{ClosureVerdict::accepted});
    CHECK(verdicts(0, 0, merge_as_in_paper) == Verdicts{ClosureVerdict::accepted});
  }

  TEST_CASE("attempts keep their distance along the path; keyframes without a proposal are no attempts") {
    Sessions sessions(2);
    for (Index i = 3; i < 20; ++i) sessions.place(40 + i, i).fitness = 0;
    Merger merger = sessions.merger({.min_travel = 7.9});
    std::vector<Index> tried;
    const auto attempts = sessions.attempts(merger);
    for (Index i = 0; i < each; ++i)
      if (!attempts[static_cast<std::size_t>(i)].empty()) tried.push_back(i);
    CHECK(tried == std::vector<Index>{3, 7, 11, 15, 19});
  }

  TEST_CASE("a keyframe that is asked for again, or that has not moved, is not tried again") {
    Sessions sessions(2);
    sessions.place(45, 6);
    Merger merger = sessions.merger({.min_travel = 0, .min_place_distance = 0});
    CHECK(merger.attempt(sessions.map, KeyframeId{45}, sessions.closer).empty());
    CHECK(merger.attempt(sessions.map, KeyframeId{45}, sessions.closer).empty());
    CHECK(merger.withdraw().size() == 1);
  }

  TEST_CASE("switched off, nothing is tried") {
    Sessions sessions(2);
    sessions.place(45, 6);
    Merger merger = sessions.merger({.enabled = false, .min_travel = 0, .confirmations = 1});
    CHECK(Outcome(sessions.attempts(merger)).verdicts.empty());
    CHECK(NoMerging().attempt(sessions.map, KeyframeId{45}, sessions.closer).empty());
    CHECK(NoMerging().withdraw().empty());
  }

  TEST_CASE("whatever is wrong, frames are joined by places that agree and keep their distance, or not at all") {
    for_all(100, [](Rng& rng, int) {
      Sessions sessions(2, rng);
      Index right = 0;
      for (Index query = 40; query < 80; query += 2 + static_cast<Index>(rng.uniform_index(4))) {
        const bool wrong = rng.uniform() < 0.7;
        right += wrong ? 0 : 1;
        sessions.place(query, static_cast<Index>(rng.uniform_index(40)),
                       wrong ? random_motion(rng, 40, 1) : random_motion(rng, 0.2, 0.01));
      }
      Merger merger = sessions.merger(unrefined);
      const Outcome outcome(sessions.attempts(merger));
      if (outcome.joined_at < 0) {
        CHECK(right <= 3);  // four right ones have at least 12 m between the first and the last
        return;
      }
      REQUIRE(outcome.accepted.size() >= 2);
      const auto T_frame = [&](const LoopClosure& closure) {
        return sessions.map.keyframes[static_cast<std::size_t>(closure.from.value)].T_map_body * closure.T_from_to *
               sessions.map.keyframes[static_cast<std::size_t>(closure.to.value)].T_map_body.inverse();
      };
      const LoopClosure& newest = outcome.accepted.back();
      const SE3d& here = sessions.map.keyframes[static_cast<std::size_t>(newest.to.value)].T_map_body;
      for (std::size_t i = 0; i + 1 < outcome.accepted.size(); ++i) {
        const LoopClosure& other = outcome.accepted[i];
        const double path = 2.0 * (newest.to.value - other.to.value);
        CHECK(path >= 10 - 1e-9);
        const SE3d difference = (T_frame(other) * here).inverse() * (T_frame(newest) * here);
        CHECK(difference.translation().norm() <= 2 + 0.02 * path);
        CHECK(difference.rotation().log().norm() <= 0.1);
      }
    });
  }
}

}  // namespace chainslam
