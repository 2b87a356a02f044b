#pragma once

#include <numbers>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/io/g2o.hpp"

namespace generated {

using namespace chainslam;

/// 200 steps around a circle of 200 m; the last pose is measured from the first.
inline std::vector<G2oEdge<SE3d>> circle_edges() {
  Rng rng(1);
  const Vector6d sigmas = (Vector6d() << 0.02, 0.02, 0.02, 0.002, 0.002, 0.002).finished();
  const auto noisy = [&](const SE3d& measured) {
    Vector6d error = sigmas;
    for (double& coordinate : error) coordinate *= rng.normal();
    return measured.retract(error);
  };
  const SE3d step(SO3d::exp({0, 0, 2 * std::numbers::pi / 200}), {1, 0, 0});
  const Matrix6d information = sigmas.cwiseAbs2().cwiseInverse().asDiagonal();
  std::vector<G2oEdge<SE3d>> edges;
  SE3d T_first_last;
  for (int i = 0; i < 199; ++i) {
    edges.push_back({i, i + 1, noisy(step), information});
    T_first_last = T_first_last * step;
  }
  edges.push_back({0, 199, noisy(T_first_last), information});
  return edges;
}

}  // namespace generated
