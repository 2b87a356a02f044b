#include "chainslam/slam/back_end.hpp"

#include <doctest/doctest.h>

#include <atomic>
#include <cmath>
#include <limits>
#include <memory>
#include <stdexcept>
#include <thread>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/slam/loop_closer.hpp"
#include "slam/street.hpp"

namespace chainslam {
namespace {

using test::drifting;
using test::keyframe_at;
using test::rotation_error;
using test::Street;
using test::translation_error;
using test::way_round;

constexpr double nan = std::numeric_limits<double>::quiet_NaN();
constexpr double degree = 0.017453292519943295;

const LoopCloserOptions small_submaps{.submap = {.radius = 6}};

SE3d shift(double x, double y, double z) { return SE3d(SO3d(), {x, y, z}); }

// ---- loop closer ----

/// The first corner of the block, seen once along the way and, a minute later, from beside it: the true pose of that
/// last scan differs from every other one in all six directions, and the graph has it wrong by 0.5 m and 2 degrees.
struct Corner {
  Street street;
  std::vector<Keyframe> keyframes;
  SE3d truth;  ///< of the last keyframe

  Corner() {
    std::vector<SE3d> poses = way_round();
    poses.resize(16);
    truth = poses[8] * SE3d(SO3d::exp({0.02, -0.03, 0.5}), {1.2, -0.8, 0.1});
    poses.push_back(truth);
    keyframes = test::keyframes_at(poses);
    for (std::size_t i = 0; i < keyframes.size(); ++i) keyframes[i].cloud = street.scan(poses[i], Rng(100 + i));
    Vector6d error;
    error << Eigen::Vector3d(0.3, -0.4, 0), 2 * degree * Eigen::Vector3d(0.1, 0.1, 0.99);
    keyframes.back().T_map_body = truth.retract(error);
    keyframes.back().time = keyframes.back().time + seconds(60);
  }

  [[nodiscard]] KeyframeId query() const { return keyframes.back().id; }

  [[nodiscard]] LoopClosure align(const ClosureGate& gate) const {
    LoopCloser<> closer({.gate = gate, .submap = small_submaps.submap});
    return closer.align(keyframes, KeyframeId{8}, query());
  }
};

/// Proposes nothing, and remembers for which keyframes it was asked.
struct AskedCandidates {
  std::shared_ptr<std::vector<Index>> asked = std::make_shared<std::vector<Index>>();

  [[nodiscard]] std::vector<KeyframeId> find(std::span<const Keyframe>, const PositionIndex&, KeyframeId query) const {
    asked->push_back(query.value);
    return {};
  }
};

/// For which of `keyframes`, added one by one, candidates are looked for.
std::vector<Index> searches(const std::vector<Keyframe>& keyframes, double min_travel) {
  const AskedCandidates candidates;
  LoopCloser<AskedCandidates> closer({.min_travel = min_travel}, candidates);
  const PositionIndex index;
  for (std::size_t i = 1; i <= keyframes.size(); ++i) CHECK(closer.close(std::span(keyframes).first(i), index).empty());
  return *candidates.asked;
}

// ---- back end ----

/// Hands out the closures of a script, each when its keyframe `to` is the newest.
struct ScriptedCloser {
  std::vector<LoopClosure> script;

  template <Executor E>
  std::vector<LoopClosure> close(std::span<const Keyframe> keyframes, const PositionIndex& index, const E&) {
    CHECK(index.size() == keyframes.size());
    std::vector<LoopClosure> due;
    for (const LoopClosure& closure : script)
      if (closure.to == keyframes.back().id) due.push_back(closure);
    return due;
  }
};
using ScriptedBackEnd = BackEnd<ScriptedCloser>;

LoopClosure measured(Index from, Index to, const SE3d& T_from_to, double sigma = 0.05) {
  return {.from = {from}, .to = {to}, .T_from_to = T_from_to, .covariance = sigma * sigma * Matrix6d::Identity()};
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
  [[nodiscard]] std::unique_ptr<const BackEnd<>> run(const E& executor) const {
    auto back_end = std::make_unique<BackEnd<>>(BackEndOptions{.odometry_noise = noise}, LoopCloser<>(small_submaps));
    for (std::size_t i = 0; i < truth.size(); ++i) {
      Keyframe next = keyframe(i);
      next.cloud = scans[i];
      back_end->add(std::move(next), executor);
    }
    return back_end;
  }
};

}  // namespace

TEST_SUITE("slam/loop_closer") {
  TEST_CASE("aligning scan i to the submap of j measures T_j_i, the pose of i seen from j") {
    const Corner corner;
    LoopCloser<> closer(small_submaps);
    PositionIndex index;
    index.rebuild(corner.keyframes);
    const std::vector<LoopClosure> tried = closer.close(corner.keyframes, index);
    REQUIRE(tried.size() == 1);
    const LoopClosure& closure = tried.front();
    CHECK(closure.verdict == ClosureVerdict::accepted);
    CHECK(closure.to == corner.query());
    const SE3d T_j_i =
        corner.keyframes[static_cast<std::size_t>(closure.from.value)].T_map_body.inverse() * corner.truth;
    // Points lie a metre apart, with a centimetre of noise; the graph was off by 0.5 m and 2 degrees.
    CHECK(translation_error(T_j_i, closure.T_from_to) < 0.05);
    CHECK(rotation_error(T_j_i, closure.T_from_to) < 0.2 * degree);
    CHECK(translation_error(T_j_i.inverse(), closure.T_from_to) > 1);
    CHECK(closure.inlier_ratio > 0.9);
    CHECK(closure.covariance == closure.covariance.transpose());
    CHECK(closure.covariance.diagonal().head<3>().maxCoeff() < 0.1 * 0.1);
  }

  TEST_CASE("a scan of another place has too few partners, and the closer goes on to the next candidate") {
    Corner corner;
    auto elsewhere = std::make_shared<PointCloud<float>>(*corner.keyframes.back().cloud);
    for (Eigen::Vector3f& p : elsewhere->positions) p.z() += 40;
    corner.keyframes.back().cloud = elsewhere;
    LoopCloser<> closer(small_submaps, {.min_separation = 4, .max_count = 2});
    PositionIndex index;
    index.rebuild(corner.keyframes);
    const std::vector<LoopClosure> tried = closer.close(corner.keyframes, index);
    REQUIRE(tried.size() == 2);
    for (const LoopClosure& closure : tried) CHECK(closure.verdict == ClosureVerdict::too_few_inliers);
    CHECK(tried[0].from != tried[1].from);
  }

  TEST_CASE("a fit that is not good enough, and one too far from the graph, are refused by name") {
    const Corner corner;
    CHECK(corner.align({}).verdict == ClosureVerdict::accepted);
    CHECK(corner.align({.max_residual = 0.005}).verdict == ClosureVerdict::high_residual);
    CHECK(corner.align({.max_mean_squared_error = 0.001}).verdict == ClosureVerdict::high_residual);
    CHECK(corner.align({.max_translation = 0.3}).verdict == ClosureVerdict::implausible);
    CHECK(corner.align({.max_rotation = 1 * degree}).verdict == ClosureVerdict::implausible);
    CHECK(corner.align({.min_inlier_ratio = 1.01}).verdict == ClosureVerdict::too_few_inliers);
  }

  TEST_CASE("the gate tells what the registration reported, and takes nothing that is not a number") {
    const ClosureGate gate;
    AlignResult good;
    good.status = AlignStatus::converged;
    good.inlier_ratio = 0.9;
    good.mean_squared_error = 0.1;
    good.mean_squared_residual = 0.01;
    const auto verdict = [&](auto&& change) {
      AlignResult result = good;
      change(result);
      return gate.judge(result, SE3d());
    };
    CHECK(verdict([](AlignResult&) {}) == ClosureVerdict::accepted);
    CHECK(verdict([](AlignResult& r) { r.status = AlignStatus::degenerate; }) == ClosureVerdict::accepted);
    CHECK(verdict([](AlignResult& r) { r.status = AlignStatus::iteration_limit; }) == ClosureVerdict::not_converged);
    CHECK(verdict([](AlignResult& r) { r.status = AlignStatus::no_overlap; }) == ClosureVerdict::too_few_inliers);
    CHECK(verdict([](AlignResult& r) { r.status = AlignStatus::too_few_points; }) == ClosureVerdict::too_few_inliers);
    CHECK(verdict([](AlignResult& r) { r.inlier_ratio = nan; }) == ClosureVerdict::too_few_inliers);
    CHECK(verdict([](AlignResult& r) { r.mean_squared_error = nan; }) == ClosureVerdict::high_residual);
    CHECK(verdict([](AlignResult& r) { r.mean_squared_residual = nan; }) == ClosureVerdict::high_residual);
    CHECK(verdict([](AlignResult& r) { r.T_target_source = shift(nan, 0, 0); }) == ClosureVerdict::implausible);
  }

  TEST_CASE("candidates are looked for once in the least travel, counted along the path") {
    std::vector<SE3d> poses;
    for (int i = 0; i < 10; ++i) poses.push_back(shift(i % 2, 0, 0));  // to and fro: a metre of path each
    const std::vector<Keyframe> keyframes = test::keyframes_at(poses);
    CHECK(searches(keyframes, 4) == std::vector<Index>{0, 4, 8});
    CHECK(searches(keyframes, 0) == std::vector<Index>{0, 1, 2, 3, 4, 5, 6, 7, 8, 9});
  }

  TEST_CASE("the leap from one session to the next is no travel") {
    std::vector<Keyframe> keyframes = test::keyframes_at({shift(0, 0, 0), shift(1, 0, 0), shift(99, 0, 0)});
    CHECK(searches(keyframes, 4) == std::vector<Index>{0, 2});
    keyframes[2].session = SessionId{1};
    CHECK(searches(keyframes, 4) == std::vector<Index>{0});
  }
}

TEST_SUITE("slam/back_end") {
  TEST_CASE("round the block, closing the loop cuts the drift to a fifth, and threads do not change a bit") {
    const ScannedRound round;
    const auto back_end = round.run(Serial{});
    const SlamMap& map = back_end->map();
    REQUIRE_FALSE(map.closures.empty());
    CHECK(back_end->counts().failed_optimisations == 0);
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
      CHECK(same.closures[i].covariance == map.closures[i].covariance);
    }
    for (std::size_t i = 0; i < map.keyframes.size(); ++i)
      CHECK(same.keyframes[i].T_map_body == map.keyframes[i].T_map_body);
  }

  TEST_CASE("one closure cuts the error to a third; T_map_odom then says where odometry's frame lies") {
    const Round round;
    const Index last = to_index(round.truth.size() - 1);
    ScriptedBackEnd back_end({.odometry_noise = Round::noise}, {{measured(2, last, round.between(2, last))}});
    for (std::size_t i = 0; i + 1 < round.truth.size(); ++i) back_end.add(round.keyframe(i));
    CHECK(back_end.snapshot() == nullptr);
    CHECK(test::translation_error(SE3d(), *back_end.T_map_odom()) < 1e-9);
    const double before = rms_error(round.truth, back_end.map().keyframes);
    back_end.add(round.keyframe(round.truth.size() - 1));
    const double after = rms_error(round.truth, back_end.map().keyframes);
    MESSAGE("rms ", before, " m -> ", after, " m");
    CHECK(before > 1.0);
    CHECK(after < before / 3);
    CHECK(back_end.counts().optimisations == 1);
    REQUIRE(back_end.snapshot() != nullptr);
    CHECK(back_end.snapshot()->keyframes.size() == round.truth.size());
    const Keyframe& newest = back_end.map().keyframes.back();
    CHECK(translation_error(newest.T_map_body, *back_end.T_map_odom() * newest.T_odom_body) < 1e-9);
  }

  TEST_CASE("a closure enters with its direction: the optimised pose of `to` seen from `from` is what was measured") {
    const SE3d T_from_to(SO3d::exp({0.1, -0.2, 0.7}), {0.5, -0.3, 0.2});
    BackEndOptions options;
    options.odometry_noise = {.translation = 1, .rotation = 0.5};  // so loose that the closure decides
    ScriptedBackEnd back_end(options, {{measured(1, 4, T_from_to, 0.01)}});
    for (int i = 0; i < 5; ++i) back_end.add(keyframe_at(i, SE3d(SO3d::exp({0, 0, 0.1 * i}), {0.2 * i, 0, 0})));
    const std::vector<Keyframe>& keyframes = back_end.map().keyframes;
    const SE3d optimised = keyframes[1].T_map_body.inverse() * keyframes[4].T_map_body;
    CHECK(translation_error(T_from_to, optimised) < 1e-3);
    CHECK(rotation_error(T_from_to, optimised) < 1e-3);
    CHECK(translation_error(SE3d(), keyframes[0].T_map_body) < 1e-3);  // the start stays
  }

  TEST_CASE("a closure with a place that only looks the same is outvoted by the others") {
    const Round round;
    std::vector<LoopClosure> script;
    for (const Index to : {80, 81, 82, 83}) script.push_back(measured(to - 80, to, round.between(to - 80, to)));
    LoopClosure wrong = measured(10, 70, round.between(10, 70) * shift(6, -4, 0));
    const auto error_of = [&](std::vector<LoopClosure> closures) {
      ScriptedBackEnd back_end({.odometry_noise = Round::noise}, {std::move(closures)});
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

  TEST_CASE("refused closures are kept apart and change nothing") {
    LoopClosure refused = measured(0, 2, shift(9, 9, 9));
    refused.verdict = ClosureVerdict::implausible;
    ScriptedBackEnd back_end({}, {{refused}});
    for (int i = 0; i < 3; ++i) back_end.add(keyframe_at(i, shift(i, 0, 0)));
    CHECK(back_end.map().closures.empty());
    REQUIRE(back_end.map().refusals.size() == 1);
    CHECK(back_end.map().refusals[0].verdict == ClosureVerdict::implausible);
    CHECK(back_end.counts().optimisations == 0);
    CHECK(back_end.graph().factors<ScriptedBackEnd::ClosureFactor>().empty());
  }

  TEST_CASE("a later session that starts elsewhere than its odometry says is moved as a whole by its closures") {
    const Round round;
    const SE3d T_map_odom(SO3d::exp({0, 0.01, 0.2}), {3, -2, 0.1});
    ScriptedBackEnd back_end(
        {}, {{measured(4, 25, round.between(4, 5), 0.02), measured(14, 35, round.between(14, 15), 0.02)}});
    back_end.begin_session("morning");
    for (std::size_t i = 0; i < 20; ++i) back_end.add(keyframe_at(static_cast<double>(i), round.truth[i]));
    back_end.begin_session("evening");
    for (std::size_t i = 0; i < 20; ++i)
      back_end.add(keyframe_at(static_cast<double>(i), T_map_odom.inverse() * round.truth[i]));
    const auto map = back_end.finish();
    REQUIRE(map->sessions.size() == 2);
    CHECK(map->sessions[1].name == "evening");
    CHECK(map->sessions[1].first_keyframe == 20);
    CHECK(map->sessions[1].keyframes == 20);
    for (std::size_t i = 0; i < 40; ++i) {
      CHECK(map->keyframes[i].session == SessionId{i < 20 ? 0 : 1});
      CHECK(translation_error(round.truth[i % 20], map->keyframes[i].T_map_body) < 0.05);
    }
    CHECK(translation_error(T_map_odom, *back_end.T_map_odom()) < 0.2);  // 0.5 degrees at 40 m
  }

  TEST_CASE("what makes no sense is refused, and the map is as it was") {
    ScriptedBackEnd back_end;
    CHECK_THROWS_AS(back_end.add(keyframe_at(0, shift(nan, 0, 0))), std::invalid_argument);
    CHECK(back_end.map().sessions.empty());
    for (int i = 0; i < 3; ++i) back_end.add(keyframe_at(i, shift(i, 0, 0)));
    const SE3d T_map_odom = *back_end.T_map_odom();
    const SE3d turned_nowhere(SO3d::exp({nan, 0, 0}), {3, 0, 0});
    for (const Keyframe& bad :
         {keyframe_at(2, shift(3, 0, 0)), keyframe_at(1, shift(3, 0, 0)), keyframe_at(3, shift(0, nan, 0)),
          keyframe_at(3, turned_nowhere), keyframe_at(3, shift(std::numeric_limits<double>::infinity(), 0, 0)),
          keyframe_at(3, shift(1e200, 0, 0))}) {
      CHECK_THROWS_AS(back_end.add(bad), std::invalid_argument);
      CHECK(back_end.map().keyframes.size() == 3);
      CHECK(back_end.map().sessions[0].keyframes == 3);
      CHECK(back_end.map().odometry.size() == 2);
      CHECK(back_end.graph().values().size() == 3);
      CHECK(back_end.graph().factor_count() == 3);
      CHECK(*back_end.T_map_odom() == T_map_odom);
    }
    CHECK(back_end.add(keyframe_at(3, shift(3, 0, 0))) == KeyframeId{3});  // life goes on
    back_end.begin_session("on another day");
    CHECK(back_end.add(keyframe_at(0, shift(0, 0, 0))) == KeyframeId{4});  // its clock may be behind
  }

  TEST_CASE("keyframes between two fixes get a position, those in an outage none, and no session that of another") {
    const auto fix_at = [](double time, double x) {
      return GnssFix{Timestamp::from_seconds(time), {x, 0, 0}, Eigen::Matrix3d::Identity(), GnssQuality::rtk_fixed};
    };
    ScriptedBackEnd back_end;
    const auto drive = [&] {
      back_end.add(keyframe_at(0.5, shift(0, 0, 0)));
      back_end.add(fix_at(1, 10));
      back_end.add(keyframe_at(1.5, shift(1, 0, 0)));
      back_end.add(fix_at(2, 20));
      back_end.add(keyframe_at(4, shift(2, 0, 0)));
      back_end.add(fix_at(9, 90));
      back_end.add(keyframe_at(9.5, shift(3, 0, 0)));
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
    BackEnd<> back_end;
    CHECK(back_end.snapshot() == nullptr);
    CHECK(back_end.T_map_odom() == nullptr);
    const auto map = back_end.finish();
    REQUIRE(map != nullptr);
    CHECK(map->keyframes.empty());
    CHECK(back_end.counts().optimisations == 0);
  }

  TEST_CASE("keyframes without a scan, or with an empty one, are mapped and close no loop") {
    const Round round;
    BackEnd<> back_end({}, LoopCloser<>(small_submaps));
    for (std::size_t i = 0; i < round.truth.size(); ++i) {
      Keyframe keyframe = round.keyframe(i);
      if (i % 2 == 0) keyframe.cloud = std::make_shared<const PointCloud<float>>();
      back_end.add(std::move(keyframe));
    }
    CHECK(back_end.map().closures.empty());
    CHECK_FALSE(back_end.map().refusals.empty());
    CHECK(back_end.map().keyframes.size() == round.truth.size());
  }

  TEST_CASE("readers on other threads see whole maps while keyframes are added") {
    const Round round;
    std::vector<LoopClosure> script;
    for (Index to = 2; to < to_index(round.truth.size()); to += 2)
      script.push_back(measured(0, to, round.between(0, to)));
    ScriptedBackEnd back_end({}, {script});
    std::atomic<bool> done = false;
    std::size_t seen = 0, torn = 0;
    std::jthread reader([&] {
      do {
        if (const auto map = back_end.snapshot()) {
          if (map->keyframes.size() < seen || map->odometry.size() + 1 != map->keyframes.size()) ++torn;
          seen = map->keyframes.size();
        }
        if (const auto frame = back_end.T_map_odom(); frame && !frame->translation().allFinite()) ++torn;
      } while (!done);
    });
    for (std::size_t i = 0; i < round.truth.size(); ++i) back_end.add(round.keyframe(i));
    const auto last = back_end.finish();
    done = true;
    reader.join();
    CHECK(torn == 0);
    CHECK(last->keyframes.size() == round.truth.size());
    CHECK(back_end.snapshot() == last);
  }
}

}  // namespace chainslam
