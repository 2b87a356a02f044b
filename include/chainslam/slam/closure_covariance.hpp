#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <concepts>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/square_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/registration/concepts.hpp"

namespace chainslam {

/// Says how far an accepted alignment may be off: the covariance of T_target_source, tangent [translation; rotation].
template <class C>
concept ClosureCovariance = requires(const C& covariance, const AlignResult& result) {
  { covariance(result) } -> std::convertible_to<Matrix6d>;
};

namespace detail {

/// Adds the squares of one number for the translation and one for the rotation to the diagonal.
inline void add_squares(Matrix6d& sum, double translation, double rotation) {
  for (int i = 0; i < 3; ++i) {
    sum(i, i) += translation * translation;
    sum(i + 3, i + 3) += rotation * rotation;
  }
}

}  // namespace detail

/// The paper's: lambda e_ij I_6, the same number for m^2 and rad^2.
struct IsotropicCovariance {
  double lambda = 1e-4;  ///< variance, m^2 and rad^2, over the mean squared error
  double least = 1e-9;   ///< m^2 and rad^2: a perfect fit is still no certainty

  /// How many residuals err as one.
  [[nodiscard]] Matrix6d operator()(const AlignResult& result) const { return (*this)(result.mean_squared_error); }
  /// @param mean_squared_error  m^2
  [[nodiscard]] Matrix6d operator()(double mean_squared_error) const {
    const double variance = std::max(lambda * mean_squared_error, least);
    Matrix6d covariance = zeros<Matrix6d>();
    for (int i = 0; i < 6; ++i) covariance(i, i) = variance;
    return covariance;
  }
};
static_assert(ClosureCovariance<IsotropicCovariance>);

/// From the registration's Hessian: directions that the points do not determine stay open.
///
/// Sigma = (H / (c s^2) + P)^-1 + F, with s^2 the mean squared residual, c the number of neighbouring residuals that
/// err together, P what is known beforehand (the pose is not off by more than the search radius) and F a floor for what
/// the residuals do not show: voxels, and the submap's own bend.
struct HessianCovariance {
  double correlated_residuals = 100;  ///< 6 x 6, of T_target_source, tangent [translation; rotation]
  double prior_translation = 5.0;     ///< metres
  double prior_rotation = 0.2;        ///< radians
  double floor_translation = 0.05;    ///< metres
  double floor_rotation = 0.002;      ///< radians

  /// 6 x 6, of T_target_source, tangent [translation; rotation].
  [[nodiscard]] [[gnu::cold]] Matrix6d operator()(const AlignResult& result) const {
    constexpr double least_residual = 1e-4;  // m^2: a centimetre, the sensor's own noise
    const double variance = correlated_residuals * std::max(result.mean_squared_residual, least_residual);
    Matrix6d information = result.hessian;
    for (int i = 0; i < 36; ++i) information.data()[i] /= variance;
    detail::add_squares(information, 1 / prior_translation, 1 / prior_rotation);
    const Matrix6d root = solved_right(identity<Matrix6d>(), cholesky(information));
    Matrix6d covariance = symmetric(times_transposed(root, root));
    detail::add_squares(covariance, floor_translation, floor_rotation);
    return covariance;
  }
};
static_assert(ClosureCovariance<HessianCovariance>);

}  // namespace chainslam
