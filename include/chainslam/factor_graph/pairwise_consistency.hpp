#pragma once

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/square_matrix.hpp"
#include "chainslam/factor_graph/between_factor.hpp"

namespace chainslam {

namespace detail {

template <class Group>
[[nodiscard]] typename Group::Jacobian covariance_of(const BetweenFactor<Group>& factor) {
  using Jacobian = typename Group::Jacobian;
  const Jacobian root = matrix_of<Jacobian>(factor.sqrt_information.data());
  const Jacobian inverse = solved_right(identity<Jacobian>(), cholesky(transposed_product(root, root)));
  return product_transposed(inverse, inverse);
}

template <class Group>
[[nodiscard]] typename Group::Jacobian carried(const typename Group::Jacobian& covariance, const Group& T) {
  return congruent(T.adjoint(), covariance);
}

}  // namespace detail

/// Whether two measurements agree, by the ways that an estimate knows between their ends: pairwise consistency
/// (Mangelson, Dominic, Eustice and Vasudevan 2018). Two of one variable are no second opinion, and do not; nor do
/// those on one variable, whose `from` is negative.
/// @param threshold  of the squared Mahalanobis distance
/// @param max_blur   standard deviations of the second up to which the ways may be uncertain: beyond, anything agrees
template <class Smoother>
[[nodiscard]] [[gnu::cold]] bool pairwise_consistent(const Smoother& estimate,
                                                     const BetweenFactor<typename Smoother::Value>& one,
                                                     const BetweenFactor<typename Smoother::Value>& other,
                                                     double threshold, double max_blur) {
  using Group = typename Smoother::Value;
  using Jacobian = typename Group::Jacobian;
  if (one.to == other.to || one.from < 0 || other.from < 0) return false;
  const Group T_to = estimate[one.to].inverse() * estimate[other.to];
  const Group T_from = estimate[one.from].inverse() * estimate[other.from];
  auto error = ((T_from * other.measurement).inverse() * (one.measurement * T_to)).log();
  const Jacobian of_noise =
      sum_of(detail::covariance_of(other), detail::carried(detail::covariance_of(one), T_to.inverse()));
  const Jacobian of_ways =
      sum_of(estimate.relative_covariance(one.to, other.to),
             detail::carried(estimate.relative_covariance(one.from, other.from), other.measurement.inverse()));
  Jacobian covariance = sum_of(of_noise, of_ways);
  const Jacobian blur = congruent(matrix_of<Jacobian>(other.sqrt_information.data()), covariance);
  double squares = 0.0;
  for (int k = 0; k < Group::dof; ++k) squares += blur(k, k);
  if (!(squares <= Group::dof * max_blur * max_blur)) return false;
  return squared_mahalanobis(covariance.data(), error.data(), Group::dof) <= threshold;
}

}  // namespace chainslam
