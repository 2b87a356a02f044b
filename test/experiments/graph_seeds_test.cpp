#include <doctest/doctest.h>

#include <cmath>
#include <memory>
#include <vector>

#include "graph/attempts.hpp"
#include "graph/graph_errors.hpp"
#include "graph/sampled_closer.hpp"
#include "graph/sampled_drives.hpp"

namespace chainslam::experiments {
namespace {

Vector6d vector6(double x, double y, double yaw) {
  Vector6d v = Vector6d::Zero();
  v[0] = x, v[1] = y, v[5] = yaw;
  return v;
}

/// Rounds of 400 m in steps of 2 m, a second each.
Trajectory rounds(Index keyframes) {
  Trajectory truth;
  for (Index i = 0; i < keyframes; ++i) {
    const double angle = 2 * 3.141592653589793 * i / 200;
    truth.times.push_back(Timestamp::from_seconds(i));
    truth.poses.emplace_back(SO3d::exp({0, 0, angle}), Eigen::Vector3d(64 * std::sin(angle), -64 * std::cos(angle), 0));
  }
  return truth;
}

Attempt attempt_at(double distance, bool converged, const Vector6d& error = Vector6d::Zero()) {
  Attempt attempt{.distance = distance, .converged = converged, .error = error};
  if (converged) attempt.sqrt_information = 20.0 * SqrtInformation<6>::Identity();
  return attempt;
}

/// Odometry's errors of a hundred steps: 2 cm and 2 mrad.
std::vector<Vector6d> step_errors() {
  Rng rng(21);
  std::vector<Vector6d> errors;
  for (int i = 0; i < 100; ++i)
    errors.push_back(vector6(0.02 * rng.normal(), 0.02 * rng.normal(), 2e-3 * rng.normal()));
  return errors;
}

/// Two sessions of two rounds each, mapped with alignments drawn from `attempts`.
struct DrawnWorld {
  std::shared_ptr<SampledScans> scans = std::make_shared<SampledScans>();
  BackEnd<SampledCloser, ChainedCloser, SampledMerger> back_end;

  DrawnWorld(const Attempts& attempts, const MergeOptions& merge, std::uint64_t seed = 1)
      : back_end({}, closer(attempts, seed), ChainedCloser(), SampledMerger(scans, merge, 10.0)) {
    const Trajectory truth = rounds(400);
    const std::vector<std::vector<Vector6d>> errors{step_errors()};
    for (std::uint64_t session = 0; session < 2; ++session) {
      const Trajectory odometry = drawn_odometry(truth, errors, Rng(seed).fork(session));
      back_end.begin_session({});
      for (std::size_t i = 0; i < odometry.size(); ++i) {
        Keyframe keyframe;
        keyframe.time = odometry.times[i];
        keyframe.T_odom_body = odometry.poses[i];
        back_end.add(std::move(keyframe));
      }
    }
    static_cast<void>(back_end.finish());
  }

  SampledCloser closer(const Attempts& attempts, std::uint64_t seed) {
    scans->attempts = attempts;
    scans->rng = Rng(seed).fork(9);
    for (int session = 0; session < 2; ++session)
      for (const SE3d& pose : rounds(400).poses) scans->truth.push_back(pose);
    return {scans, {}, {}};
  }
  [[nodiscard]] GraphErrors errors() const { return graph_errors(back_end.map(), scans->truth); }
};

Attempts good_attempts() {
  return {.closures = std::vector<Attempt>(40, attempt_at(5, true)), .merges = {attempt_at(3, true)}};
}

}  // namespace

TEST_SUITE("experiments/graph_seeds") {
  TEST_CASE("drawn errors have the mean, spread and correlation of those that were measured") {
    Rng rng(3);
    std::vector<Vector6d> measured;
    Vector6d state = Vector6d::Zero();
    for (int i = 0; i < 400; ++i) {  // x: correlated by 0.9 from step to step; y: white; yaw: a bias
      state[0] = 0.9 * state[0] + rng.normal();
      state[1] = rng.normal();
      state[5] = 0.02;
      measured.push_back(state);
    }
    const auto moments = [](const std::vector<Vector6d>& errors) {
      double square = 0, product = 0, white = 0, yaw = 0;
      for (std::size_t i = 1; i < errors.size(); ++i) {
        square += errors[i][0] * errors[i][0];
        product += errors[i][0] * errors[i - 1][0];
        white += errors[i][1] * errors[i][1];
        yaw += errors[i][5];
      }
      const auto count = static_cast<double>(errors.size() - 1);
      return std::array{square / count, product / square, white / count, yaw / count};
    };
    const auto expected = moments(measured), found = moments(drawn_errors(measured, 100'000, rng));
    CHECK(found[0] == doctest::Approx(expected[0]).epsilon(0.1));
    CHECK(found[1] == doctest::Approx(expected[1]).epsilon(0.06));  // blocks of 25: one pair in 25 is torn apart
    CHECK(found[2] == doctest::Approx(expected[2]).epsilon(0.05));
    CHECK(found[3] == doctest::Approx(0.02));
  }

  TEST_CASE("errors of a pose that the next step takes back make no random walk, and drift does") {
    Rng rng(4);
    std::vector<Vector6d> jitter, drift;
    double before = 0;
    for (int i = 0; i < 300; ++i) {
      const double now = rng.normal();
      jitter.push_back(vector6(now - before, 0, 0));
      drift.push_back(vector6(now, 0, 0));
      before = now;
    }
    const auto spread_of_ends = [&](const std::vector<Vector6d>& measured) {
      double square = 0;
      for (int draw = 0; draw < 50; ++draw) {
        double end = 0;
        for (const Vector6d& error : drawn_errors(measured, 2000, rng)) end += error[0];
        square += end * end / 50;
      }
      return std::sqrt(square);
    };
    CHECK(spread_of_ends(jitter) < 6);  // cut blocks would end sqrt(2 * 80) = 13 off
    CHECK(spread_of_ends(drift) > 30);  // sqrt(2000) = 45
  }

  TEST_CASE("drawn odometry errs in each step as was drawn, and starts at the identity") {
    const Trajectory truth = rounds(60);
    const std::vector<std::vector<Vector6d>> errors{std::vector<Vector6d>(10, vector6(0.1, -0.02, 0.003))};
    const Trajectory odometry = drawn_odometry(truth, errors, Rng(1));
    REQUIRE(odometry.size() == truth.size());
    CHECK(odometry.poses[0].translation().norm() == 0);
    for (const Vector6d& error : MeasuredDrive{truth, odometry}.step_errors())
      CHECK((error - vector6(0.1, -0.02, 0.003)).norm() < 1e-9);
  }

  TEST_CASE("alignments are drawn from attempts over like distances, at the rate at which they converged") {
    std::vector<Attempt> attempts;
    for (int i = 0; i < 100; ++i) attempts.push_back(attempt_at(0.1 * i, true));             // all of the near ones
    for (int i = 0; i < 100; ++i) attempts.push_back(attempt_at(20 + 0.1 * i, i % 4 == 0));  // a quarter of the far
    Rng rng(5);
    const auto rate = [&](double distance) {
      int converged = 0;
      for (int i = 0; i < 4000; ++i) converged += drawn(attempts, distance, rng).converged;
      return converged / 4000.0;
    };
    CHECK(rate(3) == 1.0);
    CHECK(rate(25) == doctest::Approx(0.25).epsilon(0.1));
    CHECK(rate(1000) == doctest::Approx(0.25).epsilon(0.1));
    CHECK(drawn({attempts[3]}, 7, rng).distance == attempts[3].distance);
  }

  TEST_CASE("a run's attempts have their errors by the truth, and each its own information back") {
    SlamMap map;
    map.sessions = {{SessionId{0}, {}, 0, 3, SessionId{0}, {}, {}}};
    const Trajectory truth = rounds(3);
    for (Index i = 0; i < 3; ++i) {
      Keyframe keyframe;
      keyframe.id = KeyframeId{i};
      keyframe.session = SessionId{0};
      keyframe.time = truth.times[static_cast<std::size_t>(i)];
      map.keyframes.push_back(keyframe);
    }
    const auto closure = [&](Index from, Index to, ClosureKind kind, const Vector6d& error) {
      const SE3d T_true =
          truth.poses[static_cast<std::size_t>(from)].inverse() * truth.poses[static_cast<std::size_t>(to)];
      LoopClosure one{.from = {from}, .to = {to}, .T_from_to = T_true * SE3d::exp(error)};
      one.kind = kind;
      one.sqrt_information = (20 / std::sqrt(1.5)) * SqrtInformation<6>::Identity();  // shared by two, half of it
      return one;
    };
    map.closures = {closure(0, 2, ClosureKind::direct, vector6(0.1, 0, 0.01)),
                    closure(1, 2, ClosureKind::chained, vector6(0, 2.0, 0))};
    map.closures[1].cause = 0;
    map.refusals = {closure(0, 1, ClosureKind::direct, vector6(9, 0, 0))};
    map.refusals[0].verdict = ClosureVerdict::high_residual;
    const Attempts found = attempts_of(map, {truth}, 0.5);
    REQUIRE(found.closures.size() == 3);
    CHECK(found.merges.empty());
    CHECK(std::ranges::is_sorted(found.closures, {}, &Attempt::distance));
    int right = 0, wrong = 0, refused = 0;
    for (const Attempt& attempt : found.closures) {
      if (!attempt.converged) {
        ++refused;
        continue;
      }
      CHECK(attempt.sqrt_information.data()[0] == doctest::Approx(20));
      ++(is_false(attempt.error) ? wrong : right);
      CHECK((attempt.error - (is_false(attempt.error) ? vector6(0, 2.0, 0) : vector6(0.1, 0, 0.01))).norm() < 1e-9);
    }
    CHECK((right == 1 && wrong == 1 && refused == 1));
  }

  TEST_CASE("closures that are right mend what odometry has drifted, and two sessions are joined") {
    const DrawnWorld open({}, {}), closed(good_attempts(), {.confirmations = 2});
    CHECK(open.errors().frames == 2);
    CHECK(open.back_end.map().closures.empty());
    CHECK(closed.errors().frames == 1);
    CHECK(closed.back_end.counts().merges == 1);
    CHECK(open.errors().ape.rmse > 1.0);
    CHECK(closed.errors().ape.rmse < 0.2 * open.errors().ape.rmse);
    CHECK(closed.errors().between.rmse < 0.5);
    CHECK(closed.errors().pairs > 300);
  }

  TEST_CASE("without measured merges sessions stay apart; false alignments damage the map") {
    Attempts attempts = good_attempts();
    attempts.merges.clear();
    CHECK(DrawnWorld(attempts, {}).errors().frames == 2);
    attempts = good_attempts();
    const double good = DrawnWorld(attempts, {}).errors().ape.rmse;
    for (std::size_t i = 0; i < attempts.closures.size(); i += 2) attempts.closures[i].error = vector6(4, 0, 0);
    CHECK(DrawnWorld(attempts, {}).errors().ape.rmse > 1.2 * good);
  }

  TEST_CASE("equal pairs of keyframes get equal alignments, and equal seeds equal worlds") {
    Attempts attempts;
    Rng rng(11);
    for (int i = 0; i < 40; ++i) attempts.closures.push_back(attempt_at(5, true, vector6(rng.normal(), 0, 0)));
    attempts.merges = {attempt_at(3, true)};
    DrawnWorld world(attempts, {});
    SampledCloser closer = world.closer(attempts, 1);
    const SE3d guess = world.scans->T_true(KeyframeId{3}, KeyframeId{203});
    const LoopClosure first = closer.align({}, KeyframeId{3}, KeyframeId{203}, guess);
    static_cast<void>(closer.align({}, KeyframeId{4}, KeyframeId{203}, guess));
    CHECK(
        (first.T_from_to.inverse() * closer.align({}, KeyframeId{3}, KeyframeId{203}, guess).T_from_to).log().norm() ==
        0);
    CHECK(DrawnWorld(attempts, {}).errors().ape.rmse == world.errors().ape.rmse);
    CHECK(DrawnWorld(attempts, {}, 2).errors().ape.rmse != world.errors().ape.rmse);
  }

  TEST_CASE("an alignment far from its guess is implausible, as the gate of the settings has it") {
    DrawnWorld world({}, {});
    SampledCloser closer = world.closer(good_attempts(), 1);
    const SE3d far = world.scans->T_true(KeyframeId{3}, KeyframeId{203}) * SE3d(SO3d(), {30, 0, 0});
    CHECK(closer.align({}, KeyframeId{3}, KeyframeId{203}, far).verdict == ClosureVerdict::implausible);
  }
}

}  // namespace chainslam::experiments
