#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "chainslam/factor_graph/detail/held_components.hpp"
#include "chainslam/factor_graph/detail/normal_equations.hpp"
#include "chainslam/factor_graph/factor_graph.hpp"
#include "chainslam/sparse/cholesky.hpp"

namespace chainslam {

/// The covariance of each variable at the graph's values, as a right perturbation: the diagonal blocks of (J^T J)^-1,
/// all at once, for about two factorizations more. Zero for fixed variables.
///
/// They say how uncertain the estimate is if the values are the optimum.
/// @returns nothing if a part of the graph is not held in place, or some direction is not measured.
template <class Group, class... Extra>
[[nodiscard]] std::optional<std::vector<typename Group::Jacobian>> marginals(
    const FactorGraph<Group, Extra...>& graph) {
  if (!detail::floating_components(graph).empty()) return std::nullopt;
  detail::NormalEquations<FactorGraph<Group, Extra...>> equations(graph);
  equations.linearize(graph, graph.values());
  BlockCholesky<Group::dof> solver;
  solver.analyze(equations.matrix().pattern());
  if (!solver.factorize(equations.matrix()).ok()) return std::nullopt;
  constexpr Offset block = Offset{Group::dof} * Group::dof;
  std::vector<double> blocks(static_cast<std::size_t>(equations.size() * block));
  solver.inverse_diagonal(blocks);
  std::vector<typename Group::Jacobian> covariances(static_cast<std::size_t>(graph.values().size()),
                                                    Group::Jacobian::Zero());
  for (Index column = 0; column < equations.size(); ++column)
    covariances[static_cast<std::size_t>(equations.key(column))] =
        Eigen::Map<const typename Group::Jacobian>(blocks.data() + column * block);
  return covariances;
}

}  // namespace chainslam
