#include "chainslam/slam/back_end.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <stdexcept>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/slam/loop_closer.hpp"
#include "slam/street.hpp"
#include "support/numbers.hpp"

namespace chainslam {
namespace {

using test::drifting;
using test::keyframe_at;
using test::nan;
using test::rotation_error;
using test::Street;
using test::translation_error;
using test::way_round;

/// Hands out the closures of a script, each when its keyframe `to` is the newest.
struct ScriptedCloser {
  std::vector<LoopClosure> script;

  template <Executor E>
  std::vector<LoopClosure> close(std::span<const Keyframe> keyframes, const PositionIndex& index, const E&) {
    CHECK(to_index(index.size()) == std::ranges::count(keyframes, keyframes.back().session, &Keyframe::session));
    std::vector<LoopClosure> due;
    for (const LoopClosure& closure : script)
      if (closure.to == keyframes.back().id) due.push_back(closure);
    return due;
  }
};
using PlainBackEnd = BackEnd<ScriptedCloser, NoChaining, NoMerging>;
/// The same loops closed, without what several sessions need.
using SingleSession = BackEnd<LoopCloser<>, NoChaining, NoMerging>;

LoopClosure measured(Index from, Index to, const SE3d& T_from_to, double sigma = 0.05) {
  return {
      .from = {from}, .to = {to}, .T_from_to = T_from_to, .sqrt_information = SqrtInformation<6>::Identity() / sigma};
}

/// Once round the block with odometry that drifts steadily, by about 3 m; keyframes a second apart.
struct Round {
  /// Steps that all err alike add up to much more than the same errors at random: the noise has to allow for it.
  static constexpr OdometryNoise noise{.translation = 0.05, .rotation = 0.01};

  std::vector<SE3d> truth = way_round();
  std::vector<SE3d> odometry;

  Round() {
    Vector6d error;
    error << 0.01, 0.004, 0.002, 0.0002, 0, 0.0009;
    odometry = drifting(truth, error);
  }

  [[nodiscard]] Keyframe keyframe(std::size_t i) const { return keyframe_at(static_cast<double>(i), odometry[i]); }
  [[nodiscard]] SE3d between(Index from, Index to) const {
    return truth[static_cast<std::size_t>(from)].inverse() * truth[static_cast<std::size_t>(to)];
  }
};

double rms_error(const std::vector<SE3d>& truth, const std::vector<Keyframe>& keyframes) {
  double sum = 0;
  for (std::size_t i = 0; i < keyframes.size(); ++i)
    sum += (truth[i].translation() - keyframes[i].T_map_body.translation()).squaredNorm();
  return std::sqrt(sum / static_cast<double>(keyframes.size()));
}

/// The round with its scans, which are simulated once.
struct ScannedRound : Round {
  std::vector<std::shared_ptr<const PointCloud<float>>> scans;

  ScannedRound() {
    const Street street;
    for (std::size_t i = 0; i < truth.size(); ++i) scans.push_back(street.scan(truth[i], Rng(i), 3000));
  }

  template <Executor E>
  [[nodiscard]] std::unique_ptr<SingleSession> run(const E& executor) const {
    auto back_end = std::make_unique<SingleSession>(BackEndOptions{.graph = {.odometry_noise = noise}},
                                                    LoopCloser<>(test::small_submaps));
    for (std::size_t i = 0; i < truth.size(); ++i) {
      Keyframe next = keyframe(i);
      next.cloud = scans[i];
      back_end->add(std::move(next), executor);
    }
    return back_end;
  }
};

}  // namespace

TEST_SUITE("slam/back_end") {
  TEST_CASE("round the block, closing the loop cuts the drift to a fifth, and threads do not change a bit") {
    const ScannedRound round;
    const auto back_end = round.run(Serial{});
    const SlamMap& map = back_end->map();
    REQUIRE_FALSE(map.closures.empty());
    CHECK(back_end->counts().failed_optimizations == 0);
    for (const LoopClosure& closure : map.closures) {
      CHECK(closure.from < closure.to);
      CHECK(translation_error(round.between(closure.from.value, closure.to.value), closure.T_from_to) < 0.15);
    }
    std::vector<Keyframe> unclosed = map.keyframes;
    for (Keyframe& keyframe : unclosed) keyframe.T_map_body = keyframe.T_odom_body;
    const double before = rms_error(round.truth, unclosed), after = rms_error(round.truth, map.keyframes);
    MESSAGE("rms ", before, " m -> ", after, " m, closures ", map.closures.size(), ", refused ", map.refusals.size());
    CHECK(before > 1.0);
    CHECK(after < before / 5);

    const auto threaded = round.run(ThreadPool(4));
    const SlamMap& same = threaded->map();
    REQUIRE(same.closures.size() == map.closures.size());
    for (std::size_t i = 0; i < map.closures.size(); ++i) {
      CHECK(same.closures[i].T_from_to == map.closures[i].T_from_to);
      CHECK(same.closures[i].sqrt_information == map.closures[i].sqrt_information);
    }
    for (std::size_t i = 0; i < map.keyframes.size(); ++i)
      CHECK(same.keyframes[i].T_map_body == map.keyframes[i].T_map_body);
    const auto end = back_end->finish(), same_end = threaded->finish(ThreadPool(4));
    REQUIRE(back_end->counts().end.ok());
    CHECK(threaded->counts().end.final_cost == back_end->counts().end.final_cost);
    for (std::size_t i = 0; i < map.keyframes.size(); ++i)
      CHECK(same_end->keyframes[i].T_map_body == end->keyframes[i].T_map_body);
  }

  TEST_CASE("one closure cuts the error to a third; T_map_odom then says where odometry's frame lies") {
    const Round round;
    const Index last = to_index(round.truth.size() - 1);
    PlainBackEnd back_end({.graph = {.odometry_noise = Round::noise}}, {{measured(2, last, round.between(2, last))}});
    for (std::size_t i = 0; i + 1 < round.truth.size(); ++i) back_end.add(round.keyframe(i));
    CHECK(back_end.counts().optimizations == 0);
    CHECK(test::translation_error(SE3d(), *back_end.T_map_odom()) < 1e-9);
    const double before = rms_error(round.truth, back_end.map().keyframes);
    back_end.add(round.keyframe(round.truth.size() - 1));
    const double after = rms_error(round.truth, back_end.map().keyframes);
    MESSAGE("rms ", before, " m -> ", after, " m");
    CHECK(before > 1.0);
    CHECK(after < before / 3);
    CHECK(back_end.counts().optimizations == 1);
    CHECK(back_end.snapshot()->keyframes.size() == round.truth.size());
    const Keyframe& newest = back_end.map().keyframes.back();
    CHECK(translation_error(newest.T_map_body, *back_end.T_map_odom() * newest.T_odom_body) < 1e-9);
  }

  TEST_CASE("a closure enters with its direction: the optimized pose of `to` seen from `from` is what was measured") {
    const SE3d T_from_to(SO3d::exp({0.1, -0.2, 0.7}), {0.5, -0.3, 0.2});
    BackEndOptions options;
    options.graph.odometry_noise = {.translation = 1, .rotation = 0.5};  // so loose that the closure decides
    PlainBackEnd back_end(options, {{measured(1, 4, T_from_to, 0.01)}});
    for (int i = 0; i < 5; ++i) back_end.add(keyframe_at(i, SE3d(SO3d::exp({0, 0, 0.1 * i}), {0.2 * i, 0, 0})));
    const std::vector<Keyframe>& keyframes = back_end.map().keyframes;
    const SE3d optimized = keyframes[1].T_map_body.inverse() * keyframes[4].T_map_body;
    CHECK(translation_error(T_from_to, optimized) < 1e-3);
    CHECK(rotation_error(T_from_to, optimized) < 1e-3);
    CHECK(translation_error(SE3d(), keyframes[0].T_map_body) < 1e-3);  // the start stays
  }

  TEST_CASE("a closure with a place that only looks the same is outvoted by the others") {
    const Round round;
    std::vector<LoopClosure> script;
    for (const Index to : {80, 81, 82, 83}) script.push_back(measured(to - 80, to, round.between(to - 80, to)));
    LoopClosure wrong = measured(10, 70, round.between(10, 70) * test::shift(6, -4, 0));
    const auto error_of = [&](std::vector<LoopClosure> closures) {
      PlainBackEnd back_end({.graph = {.odometry_noise = Round::noise}}, {std::move(closures)});
      for (std::size_t i = 0; i < round.truth.size(); ++i) back_end.add(round.keyframe(i));
      (void)back_end.finish();
      return rms_error(round.truth, back_end.map().keyframes);
    };
    const double without = error_of(script);
    script.insert(script.begin(), wrong);
    const double with = error_of(script);
    MESSAGE("rms without ", without, " m, with ", with, " m");
    CHECK(with < without + 0.1);
  }

  TEST_CASE("the end converges once, unless what has moved closes more loops") {
    const Round round;
    PlainBackEnd back_end({.graph = {.odometry_noise = Round::noise}}, {{measured(0, 80, round.between(0, 80))}});
    for (std::size_t i = 0; i < round.truth.size(); ++i) back_end.add(round.keyframe(i));
    (void)back_end.finish();
    const auto updates = back_end.smoother().revision();
    (void)back_end.finish();
    CHECK(back_end.smoother().revision() - updates == 2);  // of one pass
  }

  TEST_CASE("refused closures are kept apart and change nothing") {
    LoopClosure refused = measured(0, 2, test::shift(9, 9, 9));
    refused.verdict = ClosureVerdict::implausible;
    PlainBackEnd back_end({}, {{refused}});
    for (int i = 0; i < 3; ++i) back_end.add(keyframe_at(i, test::shift(i, 0, 0)));
    CHECK(back_end.map().closures.empty());
    REQUIRE(back_end.map().refusals.size() == 1);
    CHECK(back_end.map().refusals[0].verdict == ClosureVerdict::implausible);
    CHECK(back_end.counts().optimizations == 0);
    CHECK(back_end.smoother().count<BetweenFactor<SE3d>>() == to_index(back_end.map().odometry.size()));
  }

  TEST_CASE("what makes no sense is refused, and the map is as it was") {
    PlainBackEnd back_end;
    CHECK_THROWS_AS(back_end.add(keyframe_at(0, test::shift(nan, 0, 0))), std::invalid_argument);
    CHECK(back_end.map().sessions.empty());
    for (int i = 0; i < 3; ++i) back_end.add(keyframe_at(i, test::shift(i, 0, 0)));
    const SE3d T_map_odom = *back_end.T_map_odom();
    const SE3d turned_nowhere(SO3d::exp({nan, 0, 0}), {3, 0, 0});
    for (const Keyframe& bad : {keyframe_at(2, test::shift(3, 0, 0)), keyframe_at(1, test::shift(3, 0, 0)),
                                keyframe_at(3, test::shift(0, nan, 0)), keyframe_at(3, turned_nowhere),
                                keyframe_at(3, test::shift(std::numeric_limits<double>::infinity(), 0, 0)),
                                keyframe_at(3, test::shift(1e200, 0, 0))}) {
      CHECK_THROWS_AS(back_end.add(bad), std::invalid_argument);
      CHECK(back_end.map().keyframes.size() == 3);
      CHECK(back_end.map().sessions[0].keyframes == 3);
      CHECK(back_end.map().odometry.size() == 2);
      CHECK(back_end.smoother().size() == 3);
      CHECK(back_end.smoother().factor_count() == 3);
      CHECK(*back_end.T_map_odom() == T_map_odom);
    }
    CHECK(back_end.add(keyframe_at(3, test::shift(3, 0, 0))) == KeyframeId{3});  // life goes on
    back_end.begin_session("on another day");
    CHECK(back_end.add(keyframe_at(0, test::shift(0, 0, 0))) == KeyframeId{4});  // its clock may be behind
  }

  TEST_CASE("keyframes between two fixes get a position, those in an outage none, and no session that of another") {
    const auto fix_at = [](double time, double x) {
      return GnssFix{Timestamp::from_seconds(time), {x, 0, 0}, Eigen::Matrix3d::Identity(), GnssQuality::rtk_fixed};
    };
    PlainBackEnd back_end;
    const auto drive = [&] {
      back_end.add(keyframe_at(0.5, test::shift(0, 0, 0)));
      back_end.add(fix_at(1, 10));
      back_end.add(keyframe_at(1.5, test::shift(1, 0, 0)));
      back_end.add(fix_at(2, 20));
      back_end.add(keyframe_at(4, test::shift(2, 0, 0)));
      back_end.add(fix_at(9, 90));
      back_end.add(keyframe_at(9.5, test::shift(3, 0, 0)));
    };
    drive();
    back_end.begin_session("the same clock again");
    drive();
    const std::vector<Keyframe>& keyframes = back_end.map().keyframes;
    REQUIRE(keyframes.size() == 8);
    for (std::size_t i = 0; i < keyframes.size(); ++i) CHECK(keyframes[i].gnss.has_value() == (i % 4 == 1));
    for (const std::size_t i : {1U, 5U}) {
      CHECK(keyframes[i].gnss->position_ecef == Eigen::Vector3d(15, 0, 0));
      CHECK(keyframes[i].gnss->time == keyframes[i].time);
    }
  }

  TEST_CASE("nothing in gives an empty map") {
    SingleSession back_end;
    CHECK(back_end.snapshot()->keyframes.empty());
    CHECK(back_end.T_map_odom() == nullptr);
    const auto map = back_end.finish();
    REQUIRE(map != nullptr);
    CHECK(map->keyframes.empty());
    CHECK(back_end.counts().optimizations == 0);
  }

  TEST_CASE("a map that is given away is the one that is handed out as a copy") {
    const Round round;
    const auto mapped = [&](bool given) {
      PlainBackEnd back_end({.graph = {.odometry_noise = Round::noise}}, {{measured(0, 80, round.between(0, 80))}});
      for (std::size_t i = 0; i < round.truth.size(); ++i) back_end.add(round.keyframe(i));
      return given ? back_end.release() : back_end.finish();
    };
    const auto copy = mapped(false), given = mapped(true);
    CHECK(given->closures.size() == 1);
    REQUIRE(given->keyframes.size() == copy->keyframes.size());
    for (std::size_t i = 0; i < round.truth.size(); ++i)
      CHECK(given->keyframes[i].T_map_body == copy->keyframes[i].T_map_body);
  }

  TEST_CASE("keyframes without a scan, or with an empty one, are mapped and close no loop") {
    const Round round;
    SingleSession back_end({}, LoopCloser<>(test::small_submaps));
    for (std::size_t i = 0; i < round.truth.size(); ++i) {
      Keyframe keyframe = round.keyframe(i);
      if (i % 2 == 0) keyframe.cloud = std::make_shared<const PointCloud<float>>();
      back_end.add(std::move(keyframe));
    }
    CHECK(back_end.map().closures.empty());
    CHECK_FALSE(back_end.map().refusals.empty());
    CHECK(back_end.map().keyframes.size() == round.truth.size());
  }
}

}  // namespace chainslam
