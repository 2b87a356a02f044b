#pragma once

#include <Eigen/Core>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/lie/so3.hpp"

namespace chainslam {

/// What measurements alone say of a rotation, no prior included: a quadratic cost about a known rotation R. A step of
/// right tangent x (rad) from R costs x^T information x / 2 - vector^T x. Zero where nothing was measured.
struct RotationEvidence {
  SO3d about{};                                            ///< the rotation that tangents are about
  Eigen::Matrix3d information = zeros<Eigen::Matrix3d>();  ///< 1/rad^2
  Eigen::Vector3d vector = zeros<Eigen::Vector3d>();       ///< 1/rad

  /// As much as is left if all of it may have a common error of this deviation (rad) about each axis.
  [[nodiscard]] RotationEvidence with_common_error(double deviation) const {
    const double variance = deviation * deviation;
    const Eigen::Matrix3d less = inverse_of(sum_of(identity<Eigen::Matrix3d>(), scaled(variance, information)));
    return {about, product(less, information), product(less, vector)};
  }

  /// A^-1 of a regular matrix, by its adjugate.
  [[nodiscard]] static Eigen::Matrix3d inverse_of(const Eigen::Matrix3d& A) {
    Eigen::Matrix3d adjugate;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) {
        const int i1 = (i + 1) % 3, i2 = (i + 2) % 3, j1 = (j + 1) % 3, j2 = (j + 2) % 3;
        adjugate(j, i) = A(i1, j1) * A(i2, j2) - A(i1, j2) * A(i2, j1);
      }
    const double determinant = A(0, 0) * adjugate(0, 0) + A(0, 1) * adjugate(1, 0) + A(0, 2) * adjugate(2, 0);
    return divided(adjugate, determinant);
  }
};

}  // namespace chainslam
