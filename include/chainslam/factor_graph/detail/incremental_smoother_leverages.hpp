#pragma once

#include <algorithm>
#include <cstddef>
#include <limits>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/detail/linearization.hpp"
#include "chainslam/factor_graph/incremental_smoother.hpp"

namespace chainslam {

/// Leverages of whitened factors (Hoaglin and Welsch 1978, "The hat matrix"): the share of each that the graph knows
/// anyway, J H^-1 J^T, without unit; between 0 and 1 for factors of the graph that count in full.
///
/// One pass over the fronts of the Cholesky factor gives all, for about the work of two factorizations.
template <class Group, class... Extra>
class IncrementalSmoother<Group, Extra...>::Leverages {
 public:
  /// @param smoother  after an update.
  explicit Leverages(const IncrementalSmoother& smoother) : smoother_(smoother), tree_(smoother.solver_.tree()) {}

  /// For each factor an upper bound of the largest eigenvalue: the largest sum of a column's magnitudes. Infinite where
  /// no front has all its variables; there is one for each factor of the graph.
  /// @param factor  gives each of `count` factors, by its number: they need not lie side by side.
  template <class FactorAt>
  [[nodiscard]] [[gnu::cold]] detail::Table<double> bounds(Index count, const FactorAt& factor) const {
    detail::Table<double> bounds(count, std::numeric_limits<double>::infinity());
    detail::Table<Index> first(tree_.size(), -1);  // of the factors at each front
    detail::Table<std::pair<Index, Index>> list;   // a factor, and the next in its list
    for (Index i = 0; i < count; ++i)
      for (const Key key : factor(i).keys()) {
        const Index node = tree_.node_of(key);
        if (node == -1) continue;
        list.push_back({i, first[node]});
        first[node] = to_index(list.size()) - 1;
      }
    smoother_.solver_.for_each_inverse([&](Index node, const double* Z, Offset stride) {
      for (Index k = first[node]; k != -1; k = list[k].second)
        bounds[list[k].first] = std::min(bounds[list[k].first], bound(factor(list[k].first), node, Z, stride));
    });
    return bounds;
  }

 private:
  /// @param Z  the inverse among the front's variables, column-major.
  template <Factor F>
  [[nodiscard]] double bound(const F& factor, Index node, const double* Z, Offset stride) const {
    const std::vector<double> numbers = detail::linearization(factor, smoother_.estimates_, detail::Kernels::applied);
    const Offset rows = detail::rows_of(factor);
    const std::span<const Index> variables = tree_.variables(node);
    detail::Table<Offset> places;  // in the front, of the columns of J
    for (const Key key : factor.keys()) {
      if (tree_.node_of(key) == -1) continue;  // fixed
      const auto place = std::ranges::find(variables, key) - variables.begin();
      if (place == std::ssize(variables)) return std::numeric_limits<double>::infinity();
      for (int k = 0; k < dof; ++k) places.push_back(place * dof + k);
    }
    detail::Table<double> J;
    const double* of_key = numbers.data();
    for (Offset row = 0; row < rows; ++row)
      for (const Key key : factor.keys()) {
        const Tangent at_estimate = matrix_of<Tangent>(of_key);
        of_key += dof;
        if (tree_.node_of(key) == -1) continue;
        const Tangent at_origin = transposed_product(smoother_.at_estimate(key), at_estimate);
        J.append(std::span(at_origin.data(), static_cast<std::size_t>(dof)));
      }
    const Offset columns = places.size();
    detail::Table<double> product(rows * rows, 0.0);
    for (Offset row = 0; row < rows; ++row)
      for (Offset a = 0; a < columns; ++a) {
        double sum = 0.0;
        for (Offset b = 0; b < columns; ++b) sum += Z[places[a] * stride + places[b]] * J[row * columns + b];
        for (Offset other = 0; other < rows; ++other) product[row * rows + other] += sum * J[other * columns + a];
      }
    return eigenvalue_bound(product.data(), static_cast<int>(rows));
  }

  const IncrementalSmoother& smoother_;
  const detail::FrontTree<dof>& tree_;
};

}  // namespace chainslam
