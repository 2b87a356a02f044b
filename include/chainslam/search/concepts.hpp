#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <concepts>
#include <span>
#include <vector>

#include "chainslam/core/types.hpp"

namespace chainslam {

/// One answer of a search: the point's index, as `position(index)` takes it, and its squared distance to the query.
template <class Scalar = float>
struct Neighbor {
  Index index = -1;             ///< of the point, as `position(index)` takes it
  Scalar squared_distance = 0;  ///< square metres
};

/// The answer of a search for the K nearest, K known to the compiler: the first `count` are set, ascending by distance.
template <class Scalar, int K>
struct KNearest {
  static_assert(K > 0);
  std::array<Neighbor<Scalar>, static_cast<std::size_t>(K)> neighbors;  ///< the first `count` are set
  Index count = 0;                                                      ///< how many were found

  /// Those that are set, ascending by distance.
  [[nodiscard]] std::span<const Neighbor<Scalar>> found() const {
    return {neighbors.data(), static_cast<std::size_t>(count)};
  }
};

/// 2 or 3: a model says it in `dimension`; without it, 3.
template <class S>
inline constexpr int search_dimension = 3;
template <class S>
  requires requires { S::dimension; }
inline constexpr int search_dimension<S> = S::dimension;

/// A point, and a box with its rim, as the search structure S takes them.
template <class S>
using SearchVector = Eigen::Matrix<typename S::Scalar, search_dimension<S>, 1>;
template <class S>
using SearchBox = Eigen::AlignedBox<typename S::Scalar, search_dimension<S>>;

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
concept NearestNeighborSearch = requires(const S& search, const SearchVector<S>& query, typename S::Scalar distance,
                                         std::span<Neighbor<typename S::Scalar>> out,
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

/// Can start from an earlier answer.
///
/// Law: `knn(query, out, max_distance, seeds)` gives what `knn(query, out, max_distance)` gives (ties apart), sooner if
/// `seeds` is what this structure answered to a query nearby. The points of `seeds` may have been erased or moved to
/// other indices since; no index comes twice. `seeds` may be the front of `out` itself.
template <class S>
concept SeededSearch = NearestNeighborSearch<S> &&
    requires(const S& search, const SearchVector<S>& query, typename S::Scalar distance,
             std::span<Neighbor<typename S::Scalar>> out, std::span<const Neighbor<typename S::Scalar>> seeds) {
  { search.knn(query, out, distance, seeds) } -> std::same_as<Index>;
};

/// Has a search of its own for a number of neighbours that the compiler knows.
///
/// Law: `template knn<K>(query, max_distance)` answers as `knn(query, out, max_distance)` does with K places in `out`.
template <class S>
concept FixedSizeSearch = NearestNeighborSearch<S> &&
    requires(const S& search, const SearchVector<S>& query, typename S::Scalar distance) {
  { search.template knn<5>(query, distance) } -> std::same_as<KNearest<typename S::Scalar, 5>>;
};

/// A set of points that grows and shrinks while it is searched.
///
/// Laws, with "the points" the set at the time of the call:
/// - `insert(p)` is true if p has become a point; where the model downsamples (see `downsampling.hpp`) it may be left
/// out, or
///   take the place of another. `insert(cloud)` inserts the cloud's points in their order and returns by how much
///   `size()` grew. Points with NaN or infinite coordinates are never taken; `rejected()` counts them.
/// - `erase(i)` erases the point with index i, and is false if there is none. `erase_point(p)` erases all points equal
/// to
///   p; `erase_inside(box)` those in the closed box, `erase_outside(box)` the others; `erase_nearer_than(center,
///   radius)` those with distance < radius, `erase_farther_than(center, radius)` those with distance > radius;
///   `erase_if(leaves)` those for which `leaves(index, position)` holds. All return how many points went.
/// - `within_box(box, out)` replaces `out` by the indices of all points in the closed box, in any order.
/// - `for_each_point(visit)` calls `visit(index, position)` once for every point.
/// - `bounding_box()` is the smallest box that holds the points; `memory()` the bytes held, free capacity included;
///   `clear()` erases all.
/// - Indices are good until the next change. What is found, erased and visited, and in which order, depends on the
///   history of changes alone. A copy is independent of its original.
template <class S>
concept IncrementalSearch = NearestNeighborSearch<S> && std::copyable<S> &&
    requires(S& map, const S& search, const SearchVector<S>& p, const std::vector<SearchVector<S>>& cloud,
             const SearchBox<S>& box, typename S::Scalar distance, Index i, std::vector<Index>& indices,
             bool (*leaves)(Index, const SearchVector<S>&), void (*visit)(Index, const SearchVector<S>&)) {
  { map.insert(p) } -> std::same_as<bool>;
  { map.insert(cloud) } -> std::same_as<Index>;
  { map.erase(i) } -> std::same_as<bool>;
  { map.erase_point(p) } -> std::same_as<Index>;
  { map.erase_inside(box) } -> std::same_as<Index>;
  { map.erase_outside(box) } -> std::same_as<Index>;
  { map.erase_nearer_than(p, distance) } -> std::same_as<Index>;
  { map.erase_farther_than(p, distance) } -> std::same_as<Index>;
  { map.erase_if(leaves) } -> std::same_as<Index>;
  map.clear();
  search.within_box(box, indices);
  search.for_each_point(visit);
  { search.bounding_box() } -> std::same_as<SearchBox<S>>;
  { search.rejected() } -> std::same_as<Index>;
  { search.memory() } -> std::same_as<std::size_t>;
};

}  // namespace chainslam
