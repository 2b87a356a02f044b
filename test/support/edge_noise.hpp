#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <type_traits>

#include "chainslam/factor_graph/noise_model.hpp"
#include "chainslam/io/g2o.hpp"

namespace chainslam::test {

/// The noise of an edge of a public pose graph, also where its information has negative directions, as many of
/// cubicle's have: there, what is left of a Cholesky factorization that stops at the bad pivot, rotation first, is what
/// published optima take for its square root.
template <class Pose>
[[nodiscard]] NoiseModel<Pose::dof> edge_noise(const typename NoiseModel<Pose::dof>::Matrix& information) {
  using Matrix = typename NoiseModel<Pose::dof>::Matrix;
  constexpr int half = (Pose::dof + 1) / 2;  // translation
  Matrix rotation_first = Matrix::Zero();    // from [translation; rotation]
  rotation_first.template topRightCorner<Pose::dof - half, Pose::dof - half>().setIdentity();
  rotation_first.template bottomLeftCorner<half, half>().setIdentity();
  const Eigen::LLT<Matrix> factor(Matrix(rotation_first * information * rotation_first.transpose()));
  if (factor.info() == Eigen::Success) return NoiseModel<Pose::dof>::from_information(information);
  Matrix root = factor.matrixLLT().template triangularView<Eigen::Lower>();
  return NoiseModel<Pose::dof>::from_sqrt_information(root.transpose() * rotation_first);
}

}  // namespace chainslam::test
