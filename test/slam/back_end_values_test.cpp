#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/slam/back_end.hpp"
#include "slam/scripted.hpp"
#include "slam/street.hpp"

// The defaults of `BackEndOptions`: what each changes for two drives round one block.

namespace chainslam {
namespace {

/// Two drives round a block, 2.05 m between keyframes, side by side; what registration measures is exact.
struct TwoRounds {
  std::vector<SE3d> truth;  ///< of both drives
  std::vector<SE3d> odometry;
  Index each = 0;
  Index unseen =
      0;  ///< before this one, keyframes of the first drive after its fourth see nothing that the second does
  std::shared_ptr<test::Script> script = std::make_shared<test::Script>();

  /// @param slip  radians that odometry of the second drive turns too far, once, 29 m from its start.
  explicit TwoRounds(double slip = 0) {
    const std::vector<SE3d> round = test::way_round(2.05, 14.0);
    each = to_index(round.size());
    for (int drive = 0; drive < 2; ++drive)
      for (const SE3d& pose : round) truth.push_back(pose * SE3d(SO3d(), {0, 0.7 * drive, 0}));
    const SE3d T_odom_world(SO3d::exp({0, 0, 1}), {500, 0, 0});
    SE3d turned = T_odom_world;
    for (Index i = 0; i < 2 * each; ++i) {
      const SE3d& pose = truth[static_cast<std::size_t>(i)];
      if (i == each + 14) turned = turned * pose * SE3d(SO3d::exp({0, 0, slip}), {0, 0, 0}) * pose.inverse();
      odometry.push_back(i < each ? pose : turned * pose);
    }
  }

  /// Registration finds keyframe `i` of the second drive where keyframe `candidate` of the first is.
  void place(Index i, Index candidate) const {
    script->places.push_back(
        {each + i, candidate,
         truth[static_cast<std::size_t>(candidate)].inverse() * truth[static_cast<std::size_t>(each + i)]});
  }

  using Merger = MapMerger<test::ScriptedPlaces, test::ScriptedRegistration>;
  using TwoRoundsBackEnd = BackEnd<test::TruthCloser, ChainedCloser, Merger>;

  /// @param alignments  gets their number after each keyframe.
  [[nodiscard]] std::unique_ptr<TwoRoundsBackEnd> run(const BackEndOptions& options,
                                                      const ProximityCandidates& candidates = {},
                                                      std::vector<Index>* alignments = nullptr) const {
    test::TruthCloser closer;
    std::vector<SE3d> seen = truth;
    for (Index i = 4; i < unseen; ++i) seen[static_cast<std::size_t>(i)] = SE3d(SO3d(), {1e4, 0, 0});
    closer.truth = std::make_shared<const std::vector<SE3d>>(std::move(seen));
    closer.candidates = candidates;
    auto back_end = std::make_unique<TwoRoundsBackEnd>(
        options, closer, ChainedCloser(), Merger({.min_travel = 0, .confirmations = 1}, {script}, {script}));
    for (Index i = 0; i < 2 * each; ++i) {
      if (i % each == 0) back_end->begin_session(std::to_string(i / each));
      back_end->add(test::keyframe_at(i % each, odometry[static_cast<std::size_t>(i)]));
      if (alignments != nullptr) alignments->push_back(back_end->counts().alignments);
    }
    (void)back_end->finish();
    return back_end;
  }

  /// Keyframes of the second drive, from one number to another, that closures tie to the first.
  [[nodiscard]] Index tied(const SlamMap& map, Index begin, Index end) const {
    std::vector<char> is_tied(static_cast<std::size_t>(each));
    for (const LoopClosure& closure : map.closures)
      if (closure.from.value < each && closure.to.value >= each)
        is_tied[static_cast<std::size_t>(closure.to.value - each)] = 1;
    return static_cast<Index>(std::count(is_tied.begin() + begin, is_tied.begin() + end, 1));
  }
};

/// Closes each keyframe with the one `gap` before it, always as far off from where the graph has it.
struct SteadyCloser {
  static constexpr Index gap = 40;
  SE3d correction{};

  template <Executor E = Serial>
  [[nodiscard]] std::vector<LoopClosure> close(std::span<const Keyframe> keyframes, const PositionIndex&,
                                               const E& = {}) const {
    const Keyframe& here = keyframes.back();
    if (here.id.value < gap) return {};
    const Keyframe& there = keyframes[static_cast<std::size_t>(here.id.value - gap)];
    LoopClosure closure{.from = there.id, .to = here.id};
    closure.T_from_to = there.T_map_body.inverse() * here.T_map_body * correction.inverse();
    closure.sqrt_information = 1e-3 * SqrtInformation<6>::Identity();  // it hardly moves anything
    closure.verdict = ClosureVerdict::accepted;
    return {closure};
  }
};

}  // namespace

TEST_SUITE("slam/back_end: values") {
  TEST_CASE("a drive that a closure moves back is searched again where it had been too far off to be found") {
    TwoRounds rounds(-0.7);
    rounds.unseen = 30;
    rounds.place(3, 3);
    BackEndOptions never;
    never.search_again = 0;
    const auto by_default = rounds.run({}), once = rounds.run(never);
    const Index begin = 32, end = 62;
    MESSAGE("tied keyframes of 30: ", rounds.tied(once->map(), begin, end), " -> ",
            rounds.tied(by_default->map(), begin, end));
    CHECK(rounds.tied(once->map(), begin, end) == 0);
    CHECK(rounds.tied(by_default->map(), begin, end) >= 12);
  }

  TEST_CASE("a drive that is joined at its end is searched again every 4 m") {
    const TwoRounds rounds;
    rounds.place(75, 75);
    const auto back_end = rounds.run({});
    CHECK(back_end->counts().merges == 1);
    CHECK(rounds.tied(back_end->map(), 0, 70) == 34);
  }

  TEST_CASE("a drive closes loops before it is joined to another") {
    const TwoRounds rounds(0.1);
    rounds.place(78, 78);
    ProximityCandidates candidates;
    candidates.min_interval = seconds(3.0);
    candidates.min_keyframes = 0;
    BackEndOptions at_once, after_merge;
    at_once.recheck_travel = after_merge.recheck_travel = 1e9;
    after_merge.close_before_merge = false;
    const auto closures = [&](const BackEndOptions& options) {
      const auto back_end = rounds.run(options, candidates);
      return std::ranges::count_if(back_end->map().closures,
                                   [&](const LoopClosure& closure) { return closure.from.value >= rounds.each; });
    };
    const auto found = closures(at_once), late = closures(after_merge);
    MESSAGE("closures of the second drive with itself: ", late, " -> ", found);
    CHECK(found > 3 * late);
  }

  TEST_CASE("closures that correct their scan by less than 0.1 m wait until there are ten; others do not") {
    const auto optimizations = [](const SE3d& correction, const BackEndOptions& options = {}) {
      BackEnd<SteadyCloser, NoChaining, NoMerging> back_end(options, SteadyCloser{correction});
      for (Index i = 0; i < SteadyCloser::gap + 20; ++i)
        back_end.add(test::keyframe_at(i, SE3d(SO3d(), {2.0 * i, 0, 0})));
      CHECK(back_end.map().closures.size() == 20);
      return back_end.counts().optimizations;
    };
    CHECK(optimizations(SE3d(SO3d(), {0, 0.09, 0})) == 2);
    CHECK(optimizations(SE3d(SO3d(), {0, 0.11, 0})) == 20);
    CHECK(optimizations(SE3d(SO3d::exp({0, 0, 0.009}), {0, 0, 0})) == 2);  // 10 m away
    CHECK(optimizations(SE3d(SO3d::exp({0, 0, 0.011}), {0, 0, 0})) == 20);
    CHECK(optimizations(SE3d(), {.closures_at_once = 1}) == 20);
  }

  TEST_CASE("closures that wait when a session ends are taken in before the next begins") {
    BackEnd<SteadyCloser, NoChaining, NoMerging> back_end({}, SteadyCloser{SE3d(SO3d(), {0, 0.09, 0})});
    for (Index i = 0; i < SteadyCloser::gap + 3; ++i) back_end.add(test::keyframe_at(i, SE3d(SO3d(), {2.0 * i, 0, 0})));
    CHECK(back_end.counts().optimizations == 0);
    back_end.begin_session("next");
    CHECK(back_end.counts().optimizations == 1);
  }

  TEST_CASE("a drive that has candidates left when it ends is joined by them, and searched again along its way") {
    const TwoRounds rounds;
    const Index last = rounds.each - 1;
    for (const Index wrong : {30, 20}) {
      rounds.place(last, wrong);
      rounds.script->places.back().status = GlobalAlignStatus::no_consensus;
    }
    rounds.place(last, last);
    const auto back_end = rounds.run({});
    CHECK(back_end->counts().merges == 1);
    CHECK(rounds.tied(back_end->map(), 0, 70) == 34);
  }

  TEST_CASE("closures of a loaded map are in the graph at once: none waits to be forecast by the first optimization") {
    const TwoRounds rounds;
    rounds.place(60, 60);
    const auto back_end = rounds.run({});
    REQUIRE(back_end->map().closures.size() > 30);
    BackEnd<> loaded;
    loaded.load(back_end->map());
    CHECK(loaded.smoother().factor_count() == back_end->smoother().factor_count());
  }

  TEST_CASE("a keyframe that joins two frames searches nothing again: the next ones do") {
    const TwoRounds rounds;
    rounds.place(60, 60);
    std::vector<Index> alignments;
    CHECK(rounds.run({}, {}, &alignments)->counts().merges == 1);
    const auto after = alignments.begin() + rounds.each + 60;
    CHECK(after[0] == after[-1]);
    CHECK(after[1] >= after[0] + BackEndOptions{}.max_alignments);
  }

  TEST_CASE("ten fixes are worth an optimization of their own") {
    test::TruthCloser closer;
    closer.candidates.max_count = 0;  // nothing else makes one
    BackEnd<test::TruthCloser, NoChaining, NoMerging> back_end({}, closer);
    back_end.begin_session("");
    for (Index i = 0; i < 200; ++i) {
      const SE3d pose(SO3d(), {30 * std::sin(0.1 * i), -30 * std::cos(0.1 * i), 0});
      Keyframe keyframe = test::keyframe_at(i, pose);
      keyframe.gnss = test::fix_at(keyframe.time, pose.translation());
      back_end.add(std::move(keyframe));
    }
    CHECK(back_end.counts().failed_optimizations == 0);
    CHECK(back_end.counts().optimizations == 20);
  }
}

}  // namespace chainslam
