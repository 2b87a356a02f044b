#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>

#include "chainslam/core/jacobi_eigen.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam::detail {

/// Sums over pairs at one pose: the Gauss-Newton system and the figures of the result. Tangent [translation; rotation]
/// of a motion of the source's pivot and about it, in the target's axes.
struct AlignmentEquations {
  Matrix6d hessian = Matrix6d::Zero();
  Vector6d gradient = Vector6d::Zero();
  double weight = 0;       ///< sum of the kernel's weights
  double information = 0;  ///< sum of what the pairs weigh: weight times the mean square of their residuals' gradients
  double squared_residual = 0;  ///< sum of the metric's squares, m^2
  double weighted_square = 0;   ///< the same, weighed
  double cost = 0;              ///< sum of the kernel's costs, where it knows them
  double squared_distance = 0;  ///< sum of the squares of the distances, m^2
  double squared_extent = 0;    ///< sum of the squared distances of the source's points from the pivot, m^2
  Index inliers = 0;

  AlignmentEquations& operator+=(const AlignmentEquations& other) {
    hessian += other.hessian;
    gradient += other.gradient;
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
    scale_ << Eigen::Vector3d::Ones(), Eigen::Vector3d::Constant(inverse_extent);
    for (int i = 0; i < 6; ++i) {
      if (free[static_cast<std::size_t>(i)]) continue;
      scale_[i] = 0;
      ++held_;
    }
    if (weight_ > 0)
      eigen_ = jacobi_eigen<double, 6>(scale_.asDiagonal() * sums.hessian * scale_.asDiagonal() / weight_);
    for (first_told_ = 0; first_told_ < 6 && !(eigen_.values[first_told_] > threshold);) ++first_told_;
  }

  /// Directions that are free but not determined.
  [[nodiscard]] Index left_out() const { return static_cast<Index>(first_told_ - held_); }
  [[nodiscard]] const Vector6d& eigenvalues() const { return eigen_.values; }
  /// Columns, rotations in metres.
  [[nodiscard]] const Matrix6d& eigenvectors() const { return eigen_.vectors; }

  /// Where the normal equations lead, `damping` added to all eigenvalues.
  [[nodiscard]] Vector6d step(double damping) const {
    Vector6d sum = Vector6d::Zero();
    for (int i = first_told_; i < 6; ++i) {
      const Vector6d direction = scale_.asDiagonal() * eigen_.vectors.col(i);
      sum -= direction * (direction.dot(gradient_) / ((eigen_.values[i] + damping) * weight_));
    }
    return sum;
  }

  /// The Hessian without the directions left out.
  [[nodiscard]] Matrix6d hessian() const {
    Vector6d inverse_scale;
    for (int i = 0; i < 6; ++i) inverse_scale[i] = scale_[i] > 0 ? 1.0 / scale_[i] : 0.0;
    Matrix6d sum = Matrix6d::Zero();
    for (int i = first_told_; i < 6; ++i) {
      const Vector6d covector = inverse_scale.asDiagonal() * eigen_.vectors.col(i);
      sum += covector * covector.transpose() * (eigen_.values[i] * weight_);
    }
    return sum;
  }

  /// variance * hessian^-1, no direction's variance beyond `most`, m^2, which the undetermined ones have; those held by
  /// the caller have none.
  [[nodiscard]] Matrix6d covariance(double variance, double most) const {
    Matrix6d sum = Matrix6d::Zero();
    for (int i = 0; i < 6; ++i) {
      const Vector6d direction = scale_.asDiagonal() * eigen_.vectors.col(i);
      const double along = i < first_told_ ? most : std::min(variance / (eigen_.values[i] * weight_), most);
      sum += direction * direction.transpose() * along;
    }
    return sum;
  }

  /// Of each axis of the frame that `R` turns into the target's: 1 / (hessian per weight)^-1_ii, with no eigenvalue
  /// below `least`, lest an axis that leans by a hair towards one that nothing is known of be lost with it.
  [[nodiscard]] Vector6d localizability(const Eigen::Matrix3d& R, double least) const {
    Matrix6d vectors;
    vectors << R.transpose() * eigen_.vectors.topRows<3>(), R.transpose() * eigen_.vectors.bottomRows<3>();
    Vector6d result;
    for (int axis = 0; axis < 6; ++axis) {
      double variance = 0;
      for (int i = 0; i < 6; ++i) variance += vectors(axis, i) * vectors(axis, i) / std::max(eigen_.values[i], least);
      result[axis] = 1.0 / variance;
    }
    return result;
  }

 private:
  Vector6d gradient_;
  double weight_;
  Vector6d scale_;
  JacobiEigen<double, 6> eigen_{Vector6d::Zero(), Matrix6d::Identity()};
  int held_ = 0;
  int first_told_ = 0;
};

}  // namespace chainslam::detail
