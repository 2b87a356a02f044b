#pragma once

#include <Eigen/Core>
#include <algorithm>

#include "chainslam/factor_graph/concepts.hpp"
#include "chainslam/factor_graph/values.hpp"
#include "chainslam/lie/numeric_jacobian.hpp"

namespace chainslam {

/// How far a factor's Jacobians are from differences of its residual, relative to them where they are large: below 1e-8
/// where both are right, and of the order of 1 where a term is missing. For tests of one's own factors.
template <Factor F>
[[nodiscard]] double jacobian_error(const F& factor, const Values<typename F::Value>& values) {
  using Group = typename F::Value;
  const auto linearized = factor.linearize(values);
  double worst = (linearized.residual - factor.residual(values)).norm();
  const auto keys = factor.keys();
  for (std::size_t k = 0; k < F::arity; ++k) {
    const auto expected = numeric_jacobian(
        [&](const Group& moved) {
          Values<Group> others = values;
          others[keys[k]] = moved;
          return Eigen::Matrix<double, F::rows, 1>(factor.residual(others));
        },
        values[keys[k]]);
    worst = std::max(worst, (linearized.jacobians[k] - expected).norm() / (1.0 + expected.norm()));
  }
  return worst;
}

}  // namespace chainslam
