#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/symmetric_eigen.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/odometry/detail/plane_equations.hpp"

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
    for (int i = 0; i < 6; ++i) noise(i, i) += i < 3 ? floor : floor * lever * lever;
    const Matrix6d L = cholesky(noise);
    const Matrix6d half = solved_right(sum.hessian, L);
    const Matrix6d whitened = symmetric(solved_right(transposed(half), L));
    const JacobiEigen<double, 6> eigen = jacobi_eigen(whitened);
    signal = eigen.values;
    const Matrix6d to_white = solved_right(identity<Matrix6d>(), L);
    directions = product(to_white, eigen.vectors);
    coordinates = transposed_product(eigen.vectors, transposed(L));
    while (degenerate < 6 && !(signal[degenerate] > min_signal)) ++degenerate;
  }

  /// The Gauss-Newton step, without the degenerate directions.
  [[nodiscard]] Vector6d step(const Vector6d& gradient) const {
    Vector6d along = transposed_product(directions, gradient);
    for (Index i = 0; i < 6; ++i) along[i] = i < degenerate ? 0.0 : -along[i] / signal[i];
    return product(directions, along);
  }

  /// H without what it says of the degenerate directions.
  [[nodiscard]] Matrix6d seen_hessian() const {
    if (degenerate == 0) return hessian;
    Vector6d seen = signal;
    for (Index i = 0; i < degenerate; ++i) seen[i] = 0;
    return scaled_square(transposed(coordinates), seen);
  }
  /// The same for the gradient.
  [[nodiscard]] Vector6d seen_gradient(const Vector6d& gradient) const {
    if (degenerate == 0) return gradient;
    Vector6d along = transposed_product(directions, gradient);
    for (Index i = 0; i < degenerate; ++i) along[i] = 0;
    return transposed_product(coordinates, along);
  }

  /// Covariance with `variance` (m^2) per residual, and `guess_variance` (m^2 at the lever arm) in degenerate
  /// directions.
  [[nodiscard]] Matrix6d covariance(double variance, double guess_variance) const {
    Vector6d variances;
    for (Index i = 0; i < 6; ++i) {
      const Eigen::Vector3d moved = block_of<3, 1>(directions, 0, i), turned = block_of<3, 1>(directions, 3, i);
      variances[i] = i < degenerate ? guess_variance / (moved.squaredNorm() + lever * lever * turned.squaredNorm())
                                    : variance / signal[i];
    }
    return symmetric(scaled_square(directions, variances));
  }

 private:
  /// A diag(d) A^T
  [[nodiscard]] static Matrix6d scaled_square(const Matrix6d& A, const Vector6d& d) {
    Matrix6d scaled;
    for (int j = 0; j < 6; ++j)
      for (int i = 0; i < 6; ++i) scaled(i, j) = A(i, j) * d[j];
    return product_transposed(scaled, A);
  }
};

}  // namespace chainslam::detail
