#pragma once

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/lie/umeyama.hpp"
#include "chainslam/slam/group_gnc.hpp"
#include "chainslam/slam/map_graph.hpp"

namespace chainslam::test {

/// Rounds of a block, 5 m between keyframes: truth, and odometry that turns by `bend` radians a step too much and slips
/// and turns in the steps that lead to `broken`, by so many times 3.6 m and half a radian.
struct Rounds {
  static constexpr Index a_round = 40;
  std::vector<SE3d> truth;
  std::vector<SE3d> odometry;

  explicit Rounds(Index keyframes, const std::vector<Index>& broken = {}, double bend = 0, double slip = 1) {
    Rng rng(3);
    SE3d T_odom_body;
    for (Index i = 0; i < keyframes; ++i) {
      const double angle = 2 * 3.14159265358979 * i / a_round, radius = 5.0 * a_round / 6.283185307;
      truth.emplace_back(SO3d::exp({0, 0, angle}),
                         Eigen::Vector3d(radius * std::sin(angle), -radius * std::cos(angle), 0));
      if (i > 0) {
        Vector6d noise;
        for (int k = 0; k < 6; ++k) noise[k] = rng.normal(0, k < 3 ? 0.03 : 0.001);
        noise[5] += bend;
        if (std::ranges::find(broken, i) != broken.end()) noise += slip * (Vector6d() << 3, 2, 0, 0, 0, 0.5).finished();
        T_odom_body = T_odom_body * (truth[truth.size() - 2].inverse() * truth.back()).retract(noise);
      }
      odometry.push_back(T_odom_body);
    }
  }
};

/// A map that grows along a drive, with closures one round apart.
struct Growing {
  explicit Growing(const Rounds& drive, const MapGraphOptions& options = {}, const GroupGnc& gnc = {})
      : rounds(drive), graph(options, gnc) {}

  void drive_to(Index end, const Eigen::Vector3d* fix_bias = nullptr) {
    for (Index i = to_index(graph.map().keyframes.size()); i < end; ++i) {
      Keyframe keyframe{.time = Timestamp(seconds(period * i)),
                        .T_odom_body = rounds.odometry[static_cast<std::size_t>(i)]};
      if (fix_bias) keyframe.gnss = fix(i, *fix_bias);
      graph.append(keyframe);
      if (graph.waiting_fixes() >= 10) CHECK(graph.optimize().ok());  // as the back end does
    }
  }
  [[nodiscard]] GnssFix fix(Index i, const Eigen::Vector3d& bias) {
    constexpr double earth_radius = 6378137;
    Eigen::Vector3d p = rounds.truth[static_cast<std::size_t>(i)].translation() + bias;
    for (int k = 0; k < 3; ++k) p[k] += rng.normal(0, 1.0);
    return {.position_ecef = {earth_radius + p.z(), p.x(), p.y()}, .quality = GnssQuality::three_dimensional};
  }
  /// @param sigma  metres, and ten times as many radians. @returns its position among the map's closures.
  Index close(Index from, Index to, const Eigen::Vector3d& off = Eigen::Vector3d::Zero(), Index cause = -1,
              double sigma = 0.05) {
    LoopClosure closure;
    closure.from = KeyframeId{from};
    closure.to = KeyframeId{to};
    closure.T_from_to = rounds.truth[static_cast<std::size_t>(from)].inverse() *
                        rounds.truth[static_cast<std::size_t>(to)] * SE3d(SO3d(), off);
    Vector6d sigmas;
    sigmas << Eigen::Vector3d::Constant(sigma), Eigen::Vector3d::Constant(0.1 * sigma);
    closure.sqrt_information = NoiseModel<6>::from_sigmas(sigmas).sqrt_information();
    closure.kind = cause < 0 ? ClosureKind::direct : ClosureKind::chained;
    closure.cause = cause;
    return graph.accept(closure);
  }
  /// Largest error along the drive, metres, under the best alignment.
  [[nodiscard]] double worst() const {
    std::vector<Eigen::Vector3d> estimates, truth;
    for (const Keyframe& keyframe : graph.map().keyframes) {
      estimates.push_back(keyframe.T_map_body.translation());
      truth.push_back(rounds.truth[static_cast<std::size_t>(keyframe.id.value)].translation());
    }
    const Sim3d aligned = umeyama(estimates, truth, false).value();
    double most = 0;
    for (std::size_t i = 0; i < truth.size(); ++i) most = std::max(most, (aligned * estimates[i] - truth[i]).norm());
    return most;
  }
  [[nodiscard]] ClosureVerdict verdict(Index closure) const {
    return graph.map().closures[static_cast<std::size_t>(closure)].verdict;
  }

  const Rounds& rounds;
  double period = 1;  ///< seconds from keyframe to keyframe
  MapGraph<> graph;
  Rng rng{7};
};

}  // namespace chainslam::test
