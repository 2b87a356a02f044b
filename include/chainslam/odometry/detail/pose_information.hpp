#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <cmath>

#include "chainslam/core/jacobi_eigen.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/odometry/detail/plane_matches.hpp"

namespace chainslam::detail {

/// What the matches say of a pose, direction by direction, against what noise alone would make them seem to say.
///
/// Normals of planes that are parallel to a direction are never quite so, and their noise counts as information that is
/// not there. With H the sum over matches and N the part of it to be expected from the normals' noise, the eigenvalues
/// of H x = s N x are 1 in directions in which there is nothing but noise, whatever the units of x.
struct PoseInformation {
  Matrix6d hessian;      ///< H
  Matrix6d directions;   ///< columns x, with x^T N x = 1
  Matrix6d coordinates;  ///< the inverse of `directions`
  Vector6d signal;       ///< s, ascending
  double lever;          ///< metres: root mean square range of the points matched
  Index degenerate = 0;  ///< leading directions that carry too little

  PoseInformation(const PlaneEquations& sum, double min_signal)
      : hessian(sum.hessian), lever(std::max(1.0, std::sqrt(sum.squared_ranges / sum.weight))) {
    constexpr double least_tilt = 1e-3;  // radians: keeps N regular
    const double floor = sum.weight * least_tilt * least_tilt;
    Matrix6d noise = sum.noise;
    noise.diagonal().head<3>().array() += floor;
    noise.diagonal().tail<3>().array() += floor * lever * lever;
    const Eigen::LLT<Matrix6d> factor(noise);
    const Matrix6d half = factor.matrixL().solve(sum.hessian);
    const Matrix6d whitened = factor.matrixL().solve(half.transpose());
    const JacobiEigen<double, 6> eigen = jacobi_eigen(Matrix6d(0.5 * (whitened + whitened.transpose())));
    signal = eigen.values;
    directions = factor.matrixU().solve(eigen.vectors);
    coordinates = eigen.vectors.transpose() * factor.matrixU().toDenseMatrix();
    while (degenerate < 6 && !(signal[degenerate] > min_signal)) ++degenerate;
  }

  /// The Gauss-Newton step, without the degenerate directions.
  [[nodiscard]] Vector6d step(const Vector6d& gradient) const {
    Vector6d along = directions.transpose() * gradient;
    for (Index i = 0; i < 6; ++i) along[i] = i < degenerate ? 0.0 : -along[i] / signal[i];
    return directions * along;
  }

  /// H without what it says of the degenerate directions.
  [[nodiscard]] Matrix6d seen_hessian() const {
    if (degenerate == 0) return hessian;
    Vector6d seen = signal;
    seen.head(degenerate).setZero();
    return coordinates.transpose() * seen.asDiagonal() * coordinates;
  }
  /// The same for the gradient.
  [[nodiscard]] Vector6d seen_gradient(const Vector6d& gradient) const {
    if (degenerate == 0) return gradient;
    Vector6d along = directions.transpose() * gradient;
    along.head(degenerate).setZero();
    return coordinates.transpose() * along;
  }

  /// Covariance with `variance` (m^2) per residual, and `guess_variance` (m^2 at the lever arm) in degenerate
  /// directions.
  [[nodiscard]] Matrix6d covariance(double variance, double guess_variance) const {
    Vector6d variances = variance * signal.cwiseInverse();
    for (Index i = 0; i < degenerate; ++i) {
      const Vector6d x = directions.col(i);
      variances[i] = guess_variance / (x.head<3>().squaredNorm() + lever * lever * x.tail<3>().squaredNorm());
    }
    const Matrix6d result = directions * variances.asDiagonal() * directions.transpose();
    return 0.5 * (result + result.transpose());
  }
};

}  // namespace chainslam::detail
