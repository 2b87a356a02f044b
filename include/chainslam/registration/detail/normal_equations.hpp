#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/symmetric_eigen.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam::detail {

[[nodiscard]] inline Eigen::Vector3d translation_of(const Vector6d& step) { return block_of<3, 1>(step, 0, 0); }
[[nodiscard]] inline Eigen::Vector3d rotation_of(const Vector6d& step) { return block_of<3, 1>(step, 3, 0); }

/// Sums over pairs at one pose: the Gauss-Newton system and the figures of the result. Tangent [translation; rotation]
/// of a motion of the source's pivot and about it, in the target's axes.
struct AlignmentEquations {
  Matrix6d hessian = zeros<Matrix6d>();
  Vector6d gradient = zeros<Vector6d>();
  double weight = 0;       ///< sum of the kernel's weights
  double information = 0;  ///< sum of what the pairs weigh: weight times the mean square of their residuals' gradients
  double squared_residual = 0;  ///< sum of the metric's squares, m^2
  double weighted_square = 0;   ///< the same, weighed
  double cost = 0;              ///< sum of the kernel's costs, where it knows them
  double squared_distance = 0;  ///< sum of the squares of the distances, m^2
  double squared_extent = 0;    ///< sum of the squared distances of the source's points from the pivot, m^2
  Index inliers = 0;

  AlignmentEquations& operator+=(const AlignmentEquations& other) {
    hessian = sum_of(hessian, other.hessian);
    gradient = sum_of(gradient, other.gradient);
    weight += other.weight;
    information += other.information;
    squared_residual += other.squared_residual;
    weighted_square += other.weighted_square;
    cost += other.cost;
    squared_distance += other.squared_distance;
    squared_extent += other.squared_extent;
    inliers += other.inliers;
    return *this;
  }
};

/// The normal equations along the directions that are free and that the points determine.
///
/// Directions whose eigenvalue is at most a threshold are left out (solution remapping, Zhang, Kaess and Singh 2016).
/// Rotations are measured in metres of the inliers' root mean square distance from the pivot, so that all eigenvalues
/// are mean squared cosines and lie between 0 and about 1; pairs that tell little, as GICP's of surfaces that do not
/// lie alike, count for little in the mean.
class RestrictedSystem {
 public:
  /// @param free  which of the six are to be solved for.
  RestrictedSystem(const AlignmentEquations& sums, double threshold, const std::array<bool, 6>& free)
      : gradient_(sums.gradient), weight_(sums.information) {
    const double extent = sums.inliers > 0 ? std::sqrt(sums.squared_extent / static_cast<double>(sums.inliers)) : 0.0;
    const double inverse_extent = extent > 0 ? 1.0 / extent : 0.0;
    for (int i = 0; i < 6; ++i) {
      scale_[i] = i < 3 ? 1.0 : inverse_extent;
      if (free[static_cast<std::size_t>(i)]) continue;
      scale_[i] = 0;
      ++held_;
    }
    if (weight_ > 0) eigen_ = jacobi_eigen<double, 6>(scaled(sums.hessian));
    for (first_told_ = 0; first_told_ < 6 && !(eigen_.values[first_told_] > threshold);) ++first_told_;
  }

  /// Directions that are free but not determined.
  [[nodiscard]] Index left_out() const { return static_cast<Index>(first_told_ - held_); }
  [[nodiscard]] const Vector6d& eigenvalues() const { return eigen_.values; }

  /// Where the normal equations lead, `damping` added to all eigenvalues.
  [[nodiscard]] Vector6d step(double damping) const {
    Vector6d sum = zeros<Vector6d>();
    for (int i = first_told_; i < 6; ++i) {
      const Vector6d along = direction(i);
      double pull = 0;
      for (int row = 0; row < 6; ++row) pull += along[row] * gradient_[row];
      const double length = pull / ((eigen_.values[i] + damping) * weight_);
      for (int row = 0; row < 6; ++row) sum[row] -= length * along[row];
    }
    return sum;
  }

  /// The Hessian without the directions left out.
  [[nodiscard]] Matrix6d hessian() const {
    Matrix6d sum = zeros<Matrix6d>();
    for (int i = first_told_; i < 6; ++i) {
      Vector6d covector;
      for (int row = 0; row < 6; ++row) covector[row] = scale_[row] > 0 ? eigen_.vectors(row, i) / scale_[row] : 0.0;
      add_square(sum, covector, eigen_.values[i] * weight_);
    }
    return sum;
  }

  /// variance * hessian^-1, no direction's variance beyond `most`, m^2, which the undetermined ones have; those held by
  /// the caller have none.
  [[nodiscard]] Matrix6d covariance(double variance, double most) const {
    Matrix6d sum = zeros<Matrix6d>();
    for (int i = 0; i < 6; ++i) {
      const double along = i < first_told_ ? most : std::min(variance / (eigen_.values[i] * weight_), most);
      add_square(sum, direction(i), along);
    }
    return sum;
  }

  /// The eigenvectors in the axes of the frame that `R` turns into the target's.
  [[nodiscard]] Matrix6d eigenvectors(const Eigen::Matrix3d& R) const {
    Matrix6d vectors;
    for (const int row : {0, 3})
      set_block(vectors, row, 0, transposed_product(R, block_of<3, 6>(eigen_.vectors, row, 0)));
    return vectors;
  }

  /// Of each axis of that frame: 1 / (hessian per weight)^-1_ii, with no eigenvalue below `least`, lest an axis that
  /// leans by a hair towards one that nothing is known of be lost with it.
  [[nodiscard]] Vector6d localizability(const Eigen::Matrix3d& R, double least) const {
    const Matrix6d vectors = eigenvectors(R);
    Vector6d result;
    for (int axis = 0; axis < 6; ++axis) {
      double variance = 0;
      for (int i = 0; i < 6; ++i) variance += vectors(axis, i) * vectors(axis, i) / std::max(eigen_.values[i], least);
      result[axis] = 1.0 / variance;
    }
    return result;
  }

 private:
  /// The Hessian per weight, rotations in metres.
  [[nodiscard]] Matrix6d scaled(const Matrix6d& hessian) const {
    Matrix6d result;
    for (int column = 0; column < 6; ++column)
      for (int row = 0; row < 6; ++row)
        result(row, column) = scale_[row] * hessian(row, column) * scale_[column] / weight_;
    return result;
  }
  /// Eigenvector i, rotations in radians.
  [[nodiscard]] Vector6d direction(int i) const {
    Vector6d result;
    for (int row = 0; row < 6; ++row) result[row] = scale_[row] * eigen_.vectors(row, i);
    return result;
  }
  /// sum += v v' factor
  static void add_square(Matrix6d& sum, const Vector6d& v, double factor) {
    for (int column = 0; column < 6; ++column)
      for (int row = 0; row < 6; ++row) sum(row, column) += v[row] * v[column] * factor;
  }

  Vector6d gradient_;
  double weight_;
  Vector6d scale_;
  JacobiEigen<double, 6> eigen_{zeros<Vector6d>(), identity<Matrix6d>()};
  int held_ = 0;
  int first_told_ = 0;
};

}  // namespace chainslam::detail
