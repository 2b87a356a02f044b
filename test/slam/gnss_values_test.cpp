#include <doctest/doctest.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "chainslam/slam/georeference.hpp"
#include "slam/rounds.hpp"

// The defaults of `GnssFactorOptions`: six rounds of a block whose fixes wander, or are wrong for a while.

namespace chainslam {
namespace {

/// Fixes around the truth: white noise of half a metre, and an error that lasts, as those of consumers' receivers do.
struct WanderingReceiver {
  double wander = 0;     ///< metres, standard deviation of that error on each axis,
  double lasting = 150;  ///< and seconds, its time constant
  double jump = 0;       ///< metres to one side, of the fixes 100 to 119
};

/// Root mean square error of a drive of 240 keyframes without closures, metres.
/// @param bend    see `Rounds`
/// @param period  seconds from keyframe to keyframe
double error_of_drive(double bend, double period, const WanderingReceiver& receiver,
                      const GnssFactorOptions& gnss = {}) {
  constexpr double earth_radius = 6378137;
  const double kept = std::exp(-period / receiver.lasting);
  const test::Rounds rounds(240, {}, bend);
  MapGraphOptions options;
  options.gnss = gnss;
  MapGraph<> graph(options);
  Rng rng(7);
  Eigen::Vector3d wandered;
  for (int axis = 0; axis < 3; ++axis) wandered[axis] = rng.normal(0, receiver.wander);
  for (Index i = 0; i < to_index(rounds.truth.size()); ++i) {
    Eigen::Vector3d p = rounds.truth[static_cast<std::size_t>(i)].translation();
    for (int axis = 0; axis < 3; ++axis) {
      wandered[axis] = kept * wandered[axis] + std::sqrt(1 - kept * kept) * rng.normal(0, receiver.wander);
      p[axis] += wandered[axis] + rng.normal(0, 0.5);
    }
    if (i >= 100 && i < 120) p.x() += receiver.jump;
    Keyframe keyframe{.time = Timestamp(seconds(period * i)),
                      .T_odom_body = rounds.odometry[static_cast<std::size_t>(i)]};
    keyframe.gnss =
        GnssFix{.position_ecef = {earth_radius + p.z(), p.x(), p.y()}, .quality = GnssQuality::three_dimensional};
    graph.append(keyframe);
    if (graph.waiting_fixes() >= 10) CHECK(graph.optimize().ok());
  }
  CHECK(graph.converge().ok());
  std::vector<Eigen::Vector3d> estimates, truth;
  for (const Keyframe& keyframe : graph.map().keyframes) {
    estimates.push_back(keyframe.T_map_body.translation());
    truth.push_back(rounds.truth[static_cast<std::size_t>(keyframe.id.value)].translation());
  }
  const Sim3d aligned = umeyama(estimates, truth, false).value();
  double sum = 0;
  for (std::size_t i = 0; i < truth.size(); ++i) sum += (aligned * estimates[i] - truth[i]).squaredNorm();
  return std::sqrt(sum / static_cast<double>(truth.size()));
}

}  // namespace

TEST_SUITE("slam: fixes by default") {
  TEST_CASE("over an hour, fixes halve the error of a drive that bends by 0.1 degrees a step") {
    GnssFactorOptions off;
    off.enabled = false;
    const double without = error_of_drive(0.002, 20, {.wander = 2}, off),
                 with = error_of_drive(0.002, 20, {.wander = 2});
    MESSAGE("rms ", without, " -> ", with, " m");
    CHECK(without > 4);
    CHECK(with < 0.4 * without);
  }

  TEST_CASE("good odometry is hardly bent by fixes that wander by 3 m, however many there are") {
    // Odometry alone: 0.33 m. Were each fix to count by itself, one every 5 s: 2.8 m.
    for (const auto& [period, bound] : {std::pair(0.5, 0.45), std::pair(1.0, 0.7), std::pair(5.0, 1.6)}) {
      const double error = error_of_drive(0, period, {.wander = 3});
      MESSAGE("a fix every ", period, " s: rms ", error, " m");
      CHECK(error < bound);
    }
  }

  TEST_CASE("twenty fixes in a row that are 50 m off move nothing") {
    const double error = error_of_drive(0, 5, {.wander = 1, .jump = 50});
    MESSAGE("rms ", error, " m");
    CHECK(error < 0.6);
  }

  TEST_CASE("where 1200 fixes lie on the Earth is found out many times, and the graph hardly pays for it") {
    const test::Rounds rounds(1200);
    MapGraphOptions options;
    options.gnss.correlation_time = 5;  // the longer errors last, the more of the path each fix moves in any case
    test::Growing map(rounds, options);
    const Eigen::Vector3d bias(1, -1, 2);
    double most = 0;
    for (Index i = 0; i < to_index(rounds.truth.size()); ++i) {
      map.graph.append({.time = Timestamp(seconds(i)),
                        .T_odom_body = rounds.odometry[static_cast<std::size_t>(i)],
                        .gnss = map.fix(i, bias)});
      if (map.graph.waiting_fixes() < 10) continue;
      const UpdateReport report = map.graph.optimize();
      CHECK(report.ok());
      most = std::max(most, report.work.multiplications);
    }
    MESSAGE("at most ", most, " multiplications");
    CHECK(most < 3.5e5);  // 5.5e5 if each time all priors were replaced
  }

  TEST_CASE("fixes that state 15 m are used, those that state 25 m are not") {
    for (const double sigma : {15.0, 25.0}) {
      const GnssFix fix{.position_ecef = {6378137, 0, 0},
                        .covariance_ecef = sigma * sigma * Eigen::Matrix3d::Identity(),
                        .quality = GnssQuality::three_dimensional};
      CHECK(is_usable(fix, GnssFactorOptions{}) == (sigma == 15.0));
    }
  }
}

}  // namespace chainslam
