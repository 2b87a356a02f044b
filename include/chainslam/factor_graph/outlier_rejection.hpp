#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <concepts>
#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/factor_graph/batch_optimizer.hpp"
#include "chainslam/factor_graph/factor_graph.hpp"
#include "chainslam/factor_graph/factors.hpp"
#include "chainslam/factor_graph/values.hpp"

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

/// Graduated non-convexity with truncated least squares (Yang, Antonante, Tzoumas and Carlone 2020): begins with a cost
/// so smooth that every start is as good, and ends with each candidate either in or out.
struct GraduatedNonConvexity {
  /// Squared whitened residual beyond which a factor is an outlier. 0: what one good factor in a hundred exceeds.
  double threshold = 0.0;
  double growth = 1.4;                                                             ///< of the control parameter, a step
  Index max_steps = 100;                                                           ///< steps of convexity, at most
  LevenbergMarquardt optimizer{.max_iterations = 20, .relative_tolerance = 1e-6};  ///< of each step
};

/// What graduated non-convexity found.
struct GncReport {
  OptimizeReport last;          ///< of the last optimization: costs are of what was kept
  Index steps = 0;              ///< optimizations
  std::vector<double> weights;  ///< of each between factor: 1 in, 0 out; 1 for trusted ones
  bool decided = false;         ///< whether all weights are 0 or 1
};

namespace detail {

/// A factor whose squared residual counts by a weight that is kept elsewhere.
template <Factor F>
struct WeightedFactor {
  using Value = typename F::Value;
  static constexpr std::size_t arity = F::arity;
  static constexpr int rows = F::rows;
  using Linearized = LinearizedFactor<rows, Value::dof, arity>;

  F factor;
  const double* weight = nullptr;

  [[nodiscard]] std::array<Key, arity> keys() const { return factor.keys(); }
  [[nodiscard]] Eigen::Matrix<double, rows, 1> residual(const Values<Value>& values) const {
    return std::sqrt(*weight) * factor.residual(values);
  }
  [[nodiscard]] Linearized linearize(const Values<Value>& values) const {
    Linearized result = factor.linearize(values);
    const double scale = std::sqrt(*weight);
    result.residual *= scale;
    for (auto& jacobian : result.jacobians) jacobian *= scale;
    return result;
  }
};

}  // namespace detail

/// Optimizes with outliers among the between factors for which `candidate(factor)` holds, and says which they are.
///
/// Trusted ones (odometry) must hold the graph together. If an optimization fails, the graph keeps its
/// values.
template <class Group, std::predicate<const BetweenFactor<Group>&> Candidate>
GncReport optimize(FactorGraph<Group>& graph, const GraduatedNonConvexity& method, Candidate&& candidate) {
  using Weighted = detail::WeightedFactor<BetweenFactor<Group>>;
  const double threshold = method.threshold > 0.0 ? method.threshold : chi_squared_99(Group::dof);
  const auto betweens = graph.betweens();
  GncReport report;
  report.weights.assign(betweens.size(), 1.0);
  FactorGraph<Group, Weighted> weighted;
  for (Key key = 0; key < graph.values().size(); ++key) {
    weighted.add_value(graph[key]);
    weighted.set_fixed(key, graph.is_fixed(key));
  }
  for (const auto& prior : graph.priors()) weighted.add(prior);
  std::vector<std::size_t> candidates;
  for (std::size_t k = 0; k < betweens.size(); ++k) {
    if (candidate(betweens[k])) candidates.push_back(k);
    weighted.add(Weighted{betweens[k], &report.weights[k]});
  }

  BlockCholesky<Group::dof> solver;
  std::optional<double> mu;
  while (report.steps < method.max_steps && !report.decided) {
    ++report.steps;
    report.last = optimize(weighted, method.optimizer, solver);
    if (!report.last.ok()) return report;
    std::vector<double> squares;
    for (const std::size_t k : candidates) squares.push_back(betweens[k].residual(weighted.values()).squaredNorm());
    const double largest = squares.empty() ? 0.0 : *std::max_element(squares.begin(), squares.end());
    report.decided = true;
    if (!mu && largest <= threshold) break;  // all agree at once
    mu = mu ? method.growth * *mu : threshold / (2.0 * largest - threshold);
    for (std::size_t i = 0; i < candidates.size(); ++i) {
      double& weight = report.weights[candidates[i]];
      const double next = truncated_weight(squares[i], threshold, *mu);
      report.decided = report.decided && next == weight && (next == 0.0 || next == 1.0);
      weight = next;
    }
  }
  graph.set_values(weighted.values());
  return report;
}

}  // namespace chainslam
