#include "chainslam/slam/georeference.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/factor_graph/values.hpp"

namespace chainslam {
namespace {

const SE3d T_frame_ecef = SE3d(SO3d::exp({0.3, -1.1, 0.7}), {10, 20, 30}) * SE3d(SO3d(), {-4.2e6, -1.7e5, -4.7e6});

/// Positions along a path with a corner, and noisy fixes there.
std::vector<FixedPosition> along_a_corner(Index count, double side, double noise) {
  Rng rng(5);
  std::vector<FixedPosition> fixes;
  for (Index i = 0; i < count; ++i) {
    const double way = 200.0 * i / count;
    const Eigen::Vector3d position(std::min(way, 100.0), side * std::max(way - 100.0, 0.0) / 100.0, 0.02 * way);
    Eigen::Vector3d seen = position;
    for (int k = 0; k < 3; ++k) seen[k] += rng.normal(0, noise);
    fixes.push_back({position, T_frame_ecef.inverse() * seen});
  }
  return fixes;
}

}  // namespace

TEST_SUITE("slam/georeference") {
  TEST_CASE("a frame's place on the Earth is found, whatever a tenth of the fixes say") {
    std::vector<FixedPosition> fixes = along_a_corner(80, 100, 1.0);
    for (std::size_t i = 30; i < 38; ++i) fixes[i].ecef += Eigen::Vector3d(40, 30, 0);
    const auto found = georeference(fixes, {});
    REQUIRE(found);
    for (const FixedPosition& fix : along_a_corner(80, 100, 0)) CHECK((*found * fix.ecef - fix.position).norm() < 1.5);
  }

  TEST_CASE("too few fixes, or fixes along one line, do not say") {
    CHECK_FALSE(georeference(along_a_corner(19, 100, 0.5), {}));
    CHECK(georeference(along_a_corner(24, 100, 0.5), {}));
    CHECK_FALSE(georeference(along_a_corner(80, 10, 0.5), {}));
    CHECK_FALSE(georeference({}, {}));
  }

  TEST_CASE("a fix says where the antenna is, and nothing of the attitude") {
    const GnssFactorOptions options{.antenna = {0.5, -0.2, 1.4}};
    const SE3d T_map_body(SO3d::exp({0.1, -0.2, 2.0}), {7, 8, 9});
    GnssFix fix;
    fix.covariance_ecef = Eigen::Vector3d(1, 4, 9).asDiagonal();
    constexpr double correlated = 7;
    const PriorFactor<SE3d> prior = position_prior(0, T_map_body * options.antenna, fix, T_frame_ecef.rotation(),
                                                   T_map_body.rotation(), correlated, options);
    const auto squared = [&](const SE3d& pose) {
      Values<SE3d> values;
      values.add(pose);
      return prior.residual(values).squaredNorm();
    };
    CHECK(squared(T_map_body) < 1e-12);
    CHECK(squared(T_map_body * SE3d(SO3d::exp({0, 0, 0.2}), Eigen::Vector3d::Zero())) < 1e-12);
    // Off by 3 m along an axis of the Earth: over the fix's variance there and the receiver's, which several share.
    for (int axis = 0; axis < 3; ++axis) {
      const Eigen::Vector3d off = T_frame_ecef.rotation() * (3 * Eigen::Vector3d::Unit(axis));
      const double variance = correlated * (fix.covariance_ecef(axis, axis) + options.bias * options.bias);
      CHECK(squared(SE3d(T_map_body.rotation(), T_map_body.translation() + off)) == doctest::Approx(9 / variance));
    }
  }

  TEST_CASE("the more often fixes come, the more of them count as one, as in a Gauss-Markov process") {
    const GnssFactorOptions options;
    CHECK(correlated_fixes(0.1, options) == doctest::Approx(2 * options.correlation_time / 0.1));
    CHECK(correlated_fixes(10 * options.correlation_time, options) == 1);
    // What n samples say of the mean of such a process: 1^T C^-1 1, which is 1 + (n - 1) (1 - k) / (1 + k).
    constexpr double since = 2, samples = 2000;
    const double kept = std::exp(-since / options.correlation_time);
    const double exact = 1 + (samples - 1) * (1 - kept) / (1 + kept);
    CHECK(samples / correlated_fixes(since, options) == doctest::Approx(exact).epsilon(0.1));
  }

  TEST_CASE("fixes of no use are told from others") {
    GnssFix fix{.position_ecef = {6.4e6, 0, 0}, .quality = GnssQuality::three_dimensional};
    CHECK(is_usable(fix, {}));
    fix.covariance_ecef(1, 1) = 500;
    CHECK_FALSE(is_usable(fix, {}));
    fix.covariance_ecef(1, 1) = std::nan("");
    CHECK_FALSE(is_usable(fix, {}));
    fix.covariance_ecef(1, 1) = 1;
    fix.position_ecef.x() = std::nan("");
    CHECK_FALSE(is_usable(fix, {}));
    fix.position_ecef.x() = 6.4e6;
    fix.quality = GnssQuality::none;
    CHECK_FALSE(is_usable(fix, {}));
  }
}

}  // namespace chainslam
