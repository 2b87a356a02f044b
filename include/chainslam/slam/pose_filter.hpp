#pragma once

#include <Eigen/Core>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/square_matrix.hpp"
#include "chainslam/factor_graph/noise_model.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/slam/odometry_doubt.hpp"

namespace chainslam {

/// A pose and how well it is known.
struct UncertainPose {
  SE3d pose{};                              ///< T_map_body
  Matrix6d covariance = zeros<Matrix6d>();  ///< tangent [translation; rotation], of a right perturbation
};

/// The covariance of which this is the square root of the inverse.
/// @param sqrt_information  R of a positive definite R^T R.
[[nodiscard]] [[gnu::cold]] inline Matrix6d covariance_of(const SqrtInformation<6>& sqrt_information) {
  const Matrix6d R = sqrt_information;
  const Matrix6d root = solved_right(identity<Matrix6d>(), cholesky(transposed_product(R, R)));
  return times_transposed(root, root);
}

/// A pose moved by odometry: the covariance is carried along and grows by the odometry's.
/// @param noise  of `T_from_to`, tangent [translation; rotation], metres and radians.
[[nodiscard]] [[gnu::cold]] inline UncertainPose moved(const UncertainPose& from, const SE3d& T_from_to,
                                                       const Matrix6d& noise) {
  return {from.pose * T_from_to, sum_of(detail::carried(from.covariance, T_from_to.inverse()), noise)};
}

/// A pose after a measurement of it.
struct CorrectedPose {
  UncertainPose pose;           ///< between the prediction and the measurement
  double squared_distance = 0;  ///< Mahalanobis, of the measurement from the prediction: chi-squared, 6 degrees
};

/// Kalman update of a pose by a measurement of the whole pose: Barfoot and Furgale 2014, to the first order.
/// @throws std::invalid_argument if the covariances' sum is not positive definite.
[[nodiscard]] [[gnu::cold]] inline CorrectedPose corrected(const UncertainPose& predicted,
                                                           const UncertainPose& measured) {
  const Vector6d innovation = predicted.pose.local(measured.pose);
  // S^-1 = R^T R for the sum S of both covariances.
  const Matrix6d R =
      NoiseModel<6>::from_covariance(symmetric(sum_of(predicted.covariance, measured.covariance))).sqrt_information();
  const Vector6d whitened = product(R, innovation);
  const Matrix6d gain = product_transposed(predicted.covariance, R);
  CorrectedPose result;
  result.squared_distance = whitened.squaredNorm();
  result.pose.pose = predicted.pose.retract(product(gain, whitened));
  result.pose.covariance = symmetric(difference_of(predicted.covariance, product_transposed(gain, gain)));
  return result;
}

}  // namespace chainslam
