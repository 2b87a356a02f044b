#include <doctest/doctest.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "graph/attempts.hpp"
#include "graph/drawn_session.hpp"
#include "graph/graph_errors.hpp"
#include "graph/sampled_closer.hpp"
#include "graph/sampled_drives.hpp"
#include "graph/town.hpp"

namespace chainslam::experiments {
namespace {

Vector6d vector6(double x, double y, double yaw) {
  Vector6d v = Vector6d::Zero();
  v[0] = x, v[1] = y, v[5] = yaw;
  return v;
}

constexpr double turn_rate = 2 * 3.141592653589793 / 200, radius = 64;

/// On a circle of 400 m, at 2 m/s.
SE3d on_circle(double time) {
  const double angle = turn_rate * time;
  return {SO3d::exp({0, 0, angle}), Eigen::Vector3d(radius * std::sin(angle), -radius * std::cos(angle), 0)};
}

/// Rounds of it, a keyframe each second.
Trajectory rounds(Index keyframes) {
  Trajectory truth;
  for (Index i = 0; i < keyframes; ++i) {
    truth.times.push_back(Timestamp::from_seconds(i));
    truth.poses.push_back(on_circle(i));
  }
  return truth;
}

/// Two rounds at their keyframes.
MeasuredDrive two_rounds() { return {.truth = rounds(400), .odometry = {}, .legs = std::vector<Leg>(400)}; }

/// With ten frames a second, and what their accelerometer measures.
MeasuredDrive with_frames(MeasuredDrive drive) {
  const Eigen::Vector3d force(0, radius * turn_rate * turn_rate, 9.80665);
  for (std::size_t i = 0; i < drive.legs.size(); ++i)
    for (int k = i == 0 ? 0 : -9; k <= 0; ++k) {
      const double time = static_cast<double>(i) + 0.1 * k;
      drive.legs[i].frames.push_back(
          {Timestamp::from_seconds(time), on_circle(time), Eigen::Vector3f((0.1 * force).cast<float>())});
    }
  return drive;
}

/// With two fixes a second, which are right.
MeasuredDrive with_fixes(MeasuredDrive drive) {
  for (std::size_t i = 0; i < drive.legs.size(); ++i)
    for (const double before : {0.75, 0.25}) {
      const double time = static_cast<double>(i) - before;
      const Eigen::Vector3d position = on_circle(time).translation();
      drive.legs[i].fixes.push_back({.time = Timestamp::from_seconds(time),
                                     .position_ecef = {6378137 + position.z(), position.x(), position.y()},
                                     .quality = GnssQuality::three_dimensional});
    }
  return drive;
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

/// Errors of roll and pitch alone: 4 mrad.
std::vector<Vector6d> leaning_errors() {
  Rng rng(22);
  std::vector<Vector6d> errors(100, Vector6d(Vector6d::Zero()));
  for (Vector6d& error : errors) error[3] = 4e-3 * rng.normal(), error[4] = 4e-3 * rng.normal();
  return errors;
}

/// What each of the two sessions is drawn from, and how they are mapped.
struct Given {
  MeasuredDrive drive = two_rounds();
  std::vector<Vector6d> errors = step_errors();
  BackEndOptions options{};
};

/// Two sessions of two rounds each, mapped with alignments drawn from `attempts`.
struct DrawnWorld {
  std::shared_ptr<SampledScans> scans = std::make_shared<SampledScans>();
  BackEnd<SampledCloser, ChainedCloser, SampledMerger> back_end;

  DrawnWorld(const Attempts& attempts, const MergeOptions& merge, std::uint64_t seed = 1, const Given& given = {})
      : back_end(given.options, closer(attempts, seed), ChainedCloser(), SampledMerger(scans, merge, 10.0)) {
    for (std::uint64_t session = 0; session < 2; ++session)
      map_session(back_end, given.drive, drawn_odometry(given.drive.truth, {given.errors}, Rng(seed).fork(session)),
                  {});
    static_cast<void>(back_end.finish());
  }

  SampledCloser closer(const Attempts& attempts, std::uint64_t seed) {
    scans->attempts = attempts;
    scans->rng = Rng(seed).fork(9);
    for (int session = 0; session < 2; ++session)
      for (const SE3d& pose : rounds(400).poses) scans->add(pose);
    return {scans, {}, {}};
  }
  [[nodiscard]] GraphErrors errors() const { return graph_errors(back_end.map(), scans->truth); }
  /// How far the map's vertical is off where the keyframes are, radians in the mean.
  [[nodiscard]] double lean() const {
    double sum = 0;
    for (const Keyframe& one : back_end.map().keyframes)
      sum += std::acos(std::min(1.0, one.T_map_body.rotation().matrix()(2, 2)));
    return sum / static_cast<double>(back_end.map().keyframes.size());
  }
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
    const Trajectory odometry = drawn_odometry(truth, errors, Rng(1)).odometry;
    REQUIRE(odometry.size() == truth.size());
    CHECK(odometry.poses[0].translation().norm() == 0);
    for (const Vector6d& error : MeasuredDrive{.truth = truth, .odometry = odometry}.step_errors())
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

  TEST_CASE("drawn frames lie on drawn odometry, with the step's error by their share of its time") {
    const MeasuredDrive drive = with_frames(two_rounds());
    const Vector6d error = vector6(0.1, -0.02, 0.003);
    const DrawnOdometry drawn = drawn_odometry(drive.truth, {{error, error}}, Rng(1));
    CHECK(drawn_frames(drive, drawn, 0).size() == 1);
    const std::vector<FrameRecord> frames = drawn_frames(drive, drawn, 7);
    REQUIRE(frames.size() == 10);
    const auto off = [](const SE3d& a, const SE3d& b) { return (a.inverse() * b).log().norm(); };
    CHECK(frames.back().time == drive.truth.times[7]);
    CHECK(off(frames.back().T_odom_body, drawn.odometry.poses[7]) < 1e-9);
    const SE3d halfway = drawn.odometry.poses[6] * on_circle(6).inverse() * on_circle(6.5) * SE3d::exp(0.5 * error);
    CHECK(off(frames[4].T_odom_body, halfway) < 1e-9);
    for (const FrameRecord& frame : frames) CHECK(frame.delta_velocity.has_value());
  }

  TEST_CASE("gravity, as the recorded accelerometer has it, holds a drawn map upright") {
    const DrawnWorld without(good_attempts(), {}, 1, {.errors = leaning_errors()});
    const DrawnWorld with(good_attempts(), {}, 1, {.drive = with_frames(two_rounds()), .errors = leaning_errors()});
    CHECK(without.lean() > 0.02);
    CHECK(with.lean() < 0.6 * without.lean());
  }

  TEST_CASE("recorded fixes hold a drawn map without closures") {
    const DrawnWorld without({}, {}), with({}, {}, 1, {.drive = with_fixes(two_rounds())});
    CHECK(with.back_end.map().keyframes[5].gnss.has_value());
    CHECK(with.errors().ape.rmse < 0.75 * without.errors().ape.rmse);
  }

  TEST_CASE("what the settings leave out changes nothing") {
    BackEndOptions options;
    options.graph.gravity.enabled = options.graph.gnss.enabled = false;
    Attempts attempts = good_attempts();
    for (int i = 0; i < 3; ++i) attempts.merges.push_back(attempt_at(3, false));
    const MergeOptions merge{.min_travel = 0, .confirmations = 3};
    const DrawnWorld without(attempts, merge, 1, {.options = options});
    const DrawnWorld with(
        attempts, merge, 1,
        {.drive = with_fixes(with_frames(two_rounds())), .errors = step_errors(), .options = options});
    CHECK(with.back_end.counts().merges == 1);
    CHECK(with.back_end.map().closures.size() == without.back_end.map().closures.size());
    for (std::size_t i = 0; i < 800; ++i) {
      const auto pose = [&](const DrawnWorld& world) { return world.back_end.map().keyframes[i].T_map_body; };
      CHECK((pose(with).inverse() * pose(without)).log().norm() < 1e-6);
    }
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

  TEST_CASE("a town grows with its sessions, and none of its places is driven more often than it may be") {
    const std::vector<MeasuredDrive> drives{two_rounds(), two_rounds()};
    const std::vector<Visit> all = visits(600, drives, {.passes = 10, .spacing = 0.5}, Rng(1));
    std::map<std::pair<double, double>, int> passes, before;
    double late = 0;  // sessions that drive where the first half has driven
    for (std::size_t i = 0; i < all.size(); ++i) {
      CHECK(all[i].drive == i % 2);
      const std::pair place{all[i].offset.x(), all[i].offset.y()};
      CHECK(std::abs(std::remainder(place.first, 0.5 * 2 * radius)) < 0.1);
      ++passes[place];
      if (i < 300) ++before[place];
      if (i >= 300 && before.contains(place)) ++late;
    }
    CHECK(passes.size() > 60);
    CHECK(passes.size() <= 90);
    for (const auto& [place, count] : passes) {
      CHECK(count <= 10);
      CHECK(std::max(std::abs(place.first), std::abs(place.second)) <= 5 * 0.5 * 2 * radius + 1);  // one of a square
    }
    CHECK(late > 50);
    for (const Visit& visit : visits(20, drives, {}, Rng(1))) CHECK(visit.offset.isZero(0));
  }

  TEST_CASE("a drive that is moved has its fixes where it is") {
    const MeasuredDrive drive = with_fixes(two_rounds());
    const Eigen::Vector3d offset(300, -200, 0);
    const std::optional<Eigen::Matrix3d> R = R_ecef_truth({drive});
    REQUIRE(R);
    const MeasuredDrive there = moved(drive, offset, R);
    CHECK(moved(drive, offset, std::nullopt).legs[7].fixes.empty());
    const auto off = [](const MeasuredDrive& one) {
      return Eigen::Vector3d(one.legs[7].fixes.front().position_ecef - one.legs[200].fixes.front().position_ecef);
    };
    CHECK((off(there) - off(drive)).norm() < 1e-6);
    CHECK((there.legs[7].fixes.front().position_ecef - drive.legs[7].fixes.front().position_ecef - *R * offset).norm() <
          1e-6);
    CHECK((there.truth.poses[7].translation() - drive.truth.poses[7].translation() - offset).norm() < 1e-9);
    CHECK(moved(drive, Eigen::Vector3d::Zero(), R).truth.poses[7].translation() == drive.truth.poses[7].translation());
    // What goes up by the truth goes up on the Earth.
    const Eigen::Vector3d up = drive.legs[7].fixes.front().position_ecef.normalized();
    CHECK(std::abs((*R * Eigen::Vector3d::UnitZ()).dot(up)) > 0.9999);
  }

  TEST_CASE("an alignment far from its guess is implausible, as the gate of the settings has it") {
    DrawnWorld world({}, {});
    SampledCloser closer = world.closer(good_attempts(), 1);
    const SE3d far = world.scans->T_true(KeyframeId{3}, KeyframeId{203}) * SE3d(SO3d(), {30, 0, 0});
    CHECK(closer.align({}, KeyframeId{3}, KeyframeId{203}, far).verdict == ClosureVerdict::implausible);
  }
}

}  // namespace chainslam::experiments
