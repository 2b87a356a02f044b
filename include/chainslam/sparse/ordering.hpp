#pragma once

#include <numeric>
#include <vector>

#include "chainslam/core/table.hpp"
#include "chainslam/sparse/block_matrix.hpp"
#include "chainslam/sparse/concepts.hpp"
#include "chainslam/sparse/detail/quotient_graph.hpp"

namespace chainslam {

/// Eliminates the columns as they are numbered.
struct Natural {
  /// The order of the pattern: 0, 1, ...
  [[nodiscard]] std::vector<Index> operator()(const BlockPattern& pattern) const {
    std::vector<Index> order(static_cast<std::size_t>(pattern.size()));
    std::iota(order.begin(), order.end(), 0);
    return order;
  }
};
static_assert(Ordering<Natural>);

/// Approximate minimum degree on the graph of blocks: little fill at nearly linear cost.
///
/// Nodes with more than 10 sqrt(n) neighbours are eliminated last. Ties go to the node met last, so that the answer
/// depends on the pattern alone.
/// Amestoy, Davis and Duff 1996, "An approximate minimum degree ordering algorithm", with aggressive absorption.
struct Amd {
  /// An approximate minimum degree order.
  [[nodiscard]] std::vector<Index> operator()(const BlockPattern& pattern) const {
    const detail::Table<Index> order = detail::QuotientGraph(pattern).eliminate();
    return {order.begin(), order.end()};
  }
};
static_assert(Ordering<Amd>);

}  // namespace chainslam
