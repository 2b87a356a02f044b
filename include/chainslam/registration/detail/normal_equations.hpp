#pragma once

#include <Eigen/Core>
#include <cmath>

#include "chainslam/core/jacobi_eigen.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam::detail {

/// Sums over pairs at one pose: the Gauss-Newton system and the figures of the result.
struct AlignmentEquations {
  Matrix6d hessian = Matrix6d::Zero();
  Vector6d gradient = Vector6d::Zero();
  double weight = 0;            ///< sum of the kernel's weights
  double squared_residual = 0;  ///< sum of the metric's squares, m^2
  double squared_distance = 0;  ///< sum of the squares of the distances, m^2
  double squared_extent = 0;    ///< sum of |p|^2 over inliers, m^2
  Index inliers = 0;

  AlignmentEquations& operator+=(const AlignmentEquations& other) {
    hessian += other.hessian;
    gradient += other.gradient;
    weight += other.weight;
    squared_residual += other.squared_residual;
    squared_distance += other.squared_distance;
    squared_extent += other.squared_extent;
    inliers += other.inliers;
    return *this;
  }
};

/// The step of the normal equations along the directions that the points determine.
struct RestrictedStep {
  Vector6d step = Vector6d::Zero();
  Matrix6d hessian = Matrix6d::Zero();      ///< without the directions left out
  Vector6d eigenvalues = Vector6d::Zero();  ///< ascending; per unit of weight, rotations scaled by the extent
  Index left_out = 0;
};

/// Solves in the eigenbasis of the Hessian and leaves out directions whose eigenvalue is at most `threshold` (solution
/// remapping, Zhang, Kaess and Singh 2016). Rotations are measured in metres of the inliers' root mean square distance
/// from the centre, so that all eigenvalues are mean squared cosines and lie between 0 and about 1.
[[nodiscard]] inline RestrictedStep solve_restricted(const AlignmentEquations& sums, double threshold) {
  RestrictedStep result;
  if (!(sums.weight > 0) || !(sums.squared_extent > 0)) {
    result.left_out = 6;
    return result;
  }
  const double extent = std::sqrt(sums.squared_extent / static_cast<double>(sums.inliers));
  Vector6d scale;
  scale << Eigen::Vector3d::Ones(), Eigen::Vector3d::Constant(1.0 / extent);
  const Matrix6d scaled = scale.asDiagonal() * sums.hessian * scale.asDiagonal() / sums.weight;
  const JacobiEigen<double, 6> eigen = jacobi_eigen(scaled);
  result.eigenvalues = eigen.values;
  for (int i = 0; i < 6; ++i) {
    if (!(eigen.values[i] > threshold)) {
      ++result.left_out;
      continue;
    }
    const Vector6d direction = scale.asDiagonal() * eigen.vectors.col(i);
    result.step -= direction * (direction.dot(sums.gradient) / (eigen.values[i] * sums.weight));
    const Vector6d covector = scale.cwiseInverse().asDiagonal() * eigen.vectors.col(i);
    result.hessian += covector * covector.transpose() * (eigen.values[i] * sums.weight);
  }
  return result;
}

}  // namespace chainslam::detail
