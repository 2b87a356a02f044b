#pragma once

#include <Eigen/Core>
#include <concepts>
#include <span>
#include <vector>

#include "chainslam/core/types.hpp"

namespace chainslam {

/// One answer of a search: the point's index, as `position(index)` takes it, and its squared distance to the query.
template <class Scalar = float>
struct Neighbor {
  Index index = -1;
  Scalar squared_distance = 0;
};

/// Finds points near a query.
///
/// Laws:
/// - `knn(query, out, max_distance)` writes the min(out.size(), points within max_distance) nearest, ascending by
///   distance, to the front of `out` and returns how many; ties may come in any order. It never allocates.
/// - `within(query, radius, out)` replaces `out` by all points with distance <= radius, in any order.
/// - `position(i)` gives the coordinates of any index that a search has returned, until the next change.
/// - const calls may run at the same time on several threads.
/// A model may be exact only up to a stated `max_search_radius()`; beyond it nothing is found.
template <class S>
concept NearestNeighborSearch = requires(const S& search, const Eigen::Matrix<typename S::Scalar, 3, 1>& query,
                                         typename S::Scalar distance, std::span<Neighbor<typename S::Scalar>> out,
                                         std::vector<Neighbor<typename S::Scalar>>& all, Index i) {
  { search.knn(query, out, distance) } -> std::same_as<Index>;
  search.within(query, distance, all);
  { search.position(i)[0] } -> std::convertible_to<typename S::Scalar>;
  { search.size() } -> std::convertible_to<std::size_t>;
};

/// A search structure that also has a unit normal for each point.
template <class S>
concept OrientedSearch = NearestNeighborSearch<S> && requires(const S& search, Index i) {
  { search.normal(i)[0] } -> std::convertible_to<typename S::Scalar>;
};

}  // namespace chainslam
