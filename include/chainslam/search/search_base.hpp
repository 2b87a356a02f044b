#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <limits>
#include <span>
#include <stdexcept>
#include <utility>
#include <vector>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/search/concepts.hpp"
#include "chainslam/search/detail/nearest_list.hpp"
#include "chainslam/search/detail/point_source.hpp"
#include "chainslam/search/detail/radius_list.hpp"
#include "chainslam/search/detail/regions.hpp"

namespace chainslam {

/// The queries that all search structures share: `IkdTree`, `VoxelMap`, `KdTree`, `BruteForce` and `NanoflannTree`
/// derive from it. `knn(query, 5)` and `radius(query, r)` return vectors; the others write to the caller's memory and
/// allocate nothing, or only `out`.
///
/// A query is in the frame of the points, metres; of a query with NaN nothing is found. Searching a balanced tree of n
/// points for k takes O(k log n) on average. Const calls may run at the same time on several threads, but not during a
/// change.
///
/// @tparam Model  the derived class, which says how a collector goes through its points: `search(query, found)` offers
///                every point with squared distance < `found.bound()`; `contains(i)`, whether i is the index of a
///                point, `position(i)`, `size()`, and `max_search_radius()` if there is one.
template <class Model, class ScalarType, int Dim>
class SearchBase {
 public:
  using Scalar = ScalarType;                     ///< of coordinates and distances: float or double
  using Vector = Eigen::Matrix<Scalar, Dim, 1>;  ///< a point
  static constexpr int dimension = Dim;          ///< 2 or 3

  /// The k points nearest to the query within `max_distance` (metres), ascending by distance; fewer if there are not
  /// so many. For few queries: the overload that writes to `out` does not allocate.
  /// @throws std::invalid_argument if k is negative.
  [[nodiscard]] std::vector<Neighbor<Scalar>> knn(const Vector& query, Index k,
                                                  Scalar max_distance = std::numeric_limits<Scalar>::infinity()) const {
    if (k < 0) throw std::invalid_argument("knn: the number of neighbours must not be negative");
    std::vector<Neighbor<Scalar>> found(std::min(static_cast<std::size_t>(k), model().size()));
    found.resize(static_cast<std::size_t>(knn(query, found, max_distance)));
    return found;
  }

  /// All points with distance <= `radius` (metres), ascending by distance, then by index.
  [[nodiscard]] std::vector<Neighbor<Scalar>> radius(const Vector& query, Scalar radius) const {
    std::vector<Neighbor<Scalar>> found;
    within(query, radius, found);
    std::sort(found.begin(), found.end(), [](const Neighbor<Scalar>& a, const Neighbor<Scalar>& b) {
      return std::pair(a.squared_distance, a.index) < std::pair(b.squared_distance, b.index);
    });
    return found;
  }

  /// Writes the nearest points within `max_distance` (metres), as many as `out` takes, to its front, ascending by
  /// distance, and returns how many; see `NearestNeighborSearch`. A bound in `max_distance` makes it faster.
  Index knn(const Vector& query, std::span<Neighbor<Scalar>> out,
            Scalar max_distance = std::numeric_limits<Scalar>::infinity()) const {
    return nearest(query, out, detail::distance_bound(limited(max_distance)));
  }

  /// The same from an earlier answer to a query nearby, which makes it faster; see `SeededSearch`.
  Index knn(const Vector& query, std::span<Neighbor<Scalar>> out, Scalar max_distance,
            std::span<const Neighbor<Scalar>> seeds) const {
    const Scalar bound = detail::distance_bound(limited(max_distance));
    return nearest(query, out, std::min(bound, seed_bound(query, seeds, out.size())));
  }

  /// The K nearest points, K known to the compiler, without an allocation; see `FixedSizeSearch`.
  template <int K>
  [[nodiscard]] KNearest<Scalar, K> knn(const Vector& query,
                                        Scalar max_distance = std::numeric_limits<Scalar>::infinity()) const {
    detail::FixedNearestList<Scalar, K> found(detail::distance_bound(limited(max_distance)));
    model().search(query, found);
    return found.result();
  }

  /// Replaces `out` by all points with distance <= `radius` (metres), in any order.
  void within(const Vector& query, Scalar radius, std::vector<Neighbor<Scalar>>& out) const {
    detail::RadiusList<Scalar> found(out, detail::distance_bound(limited(radius)));
    model().search(query, found);
  }

 private:
  [[nodiscard]] const Model& model() const { return static_cast<const Model&>(*this); }

  [[nodiscard]] Scalar limited(Scalar distance) const {
    if constexpr (requires(const Model& m) { m.max_search_radius(); })
      return std::min(distance, model().max_search_radius());
    else
      return distance;
  }

  [[nodiscard]] Index nearest(const Vector& query, std::span<Neighbor<Scalar>> out, Scalar bound) const {
    if (out.size() <= static_cast<std::size_t>(detail::SmallNearest<Scalar>::max_k)) {
      detail::SmallNearest<Scalar> found(out.size(), bound);
      model().search(query, found);
      return found.write(out);
    }
    detail::NearestList<Scalar> found(out, bound);
    model().search(query, found);
    return found.size();
  }

  /// A bound above the k-th smallest squared distance, from k points that are there: those of the seeds that are left.
  [[nodiscard]] Scalar seed_bound(const Vector& query, std::span<const Neighbor<Scalar>> seeds, std::size_t k) const {
    // The search may round the same sum of squares otherwise.
    constexpr Scalar rounding = 1 + 8 * std::numeric_limits<Scalar>::epsilon();
    Scalar farthest = 0;
    std::size_t left = 0;
    for (const Neighbor<Scalar>& seed : seeds) {
      if (left == k) break;
      if (!model().contains(seed.index)) continue;
      const auto& p = model().position(seed.index);
      farthest = std::max(farthest, squared_distance<Dim>(p.data(), query.data()));
      ++left;
    }
    const bool enough = left == k && farthest < std::numeric_limits<Scalar>::max() / 2;
    return enough ? detail::next_above(farthest * rounding) : std::numeric_limits<Scalar>::infinity();
  }
};

/// What all search structures share that grow and shrink, `IkdTree`, `VoxelMap` and `BruteForce`: see
/// `IncrementalSearch` for what each call promises.
///
/// @tparam Model  as for `SearchBase`; it also has `insert(p)`, `for_each_point(visit)`, `erase_region(region)`, which
///                erases the region's points and returns how many there were, and `visit_region(region, visit)`, which
///                calls `visit(index, position)` for each of them.
template <class Model, class ScalarType, int Dim>
class IncrementalSearchBase : public SearchBase<Model, ScalarType, Dim> {
  using Base = SearchBase<Model, ScalarType, Dim>;

 public:
  using typename Base::Scalar;
  using typename Base::Vector;
  using Box = Eigen::AlignedBox<Scalar, Dim>;  ///< closed

  /// Inserts the points in their order. Returns by how much `size()` grew.
  template <detail::PointSource<Dim> Points>
  Index insert(const Points& points) {
    const std::size_t before = model().size();
    const Index count = detail::source_size<Dim>(points);
    for (Index i = 0; i < count; ++i) model().insert(detail::source_position<Scalar, Dim>(points, i));
    return static_cast<Index>(model().size() - before);
  }

  /// Erases the points equal to p. Returns how many went.
  Index erase_point(const Vector& p) { return erase_inside(Box(p, p)); }
  /// Erases the points of the closed box. Returns how many went.
  Index erase_inside(const Box& box) { return model().erase_region(detail::BoxRegion<Scalar, Dim>{box}); }
  /// Erases the points outside the closed box. Returns how many went.
  Index erase_outside(const Box& box) {
    return model().erase_region(detail::Complement<detail::BoxRegion<Scalar, Dim>>{{box}});
  }
  /// Erases the points whose distance from `center` is below `radius` (metres). Returns how many went.
  Index erase_nearer_than(const Vector& center, Scalar radius) {
    return model().erase_region(detail::BallRegion<Scalar, Dim>{center, radius > 0 ? radius * radius : 0});
  }
  /// Erases the points whose distance from `center` exceeds `radius` (metres). Returns how many went.
  Index erase_farther_than(const Vector& center, Scalar radius) {
    return model().erase_region(
        detail::Complement<detail::BallRegion<Scalar, Dim>>{{center, detail::distance_bound(radius)}});
  }

  /// Replaces `out` by the indices of the points in the closed box.
  void within_box(const Box& box, std::vector<Index>& out) const {
    out.clear();
    model().visit_region(detail::BoxRegion<Scalar, Dim>{box}, [&](Index i, const Vector&) { out.push_back(i); });
  }

  /// The smallest box that holds the points.
  [[nodiscard]] Box bounding_box() const {
    Box box;
    model().for_each_point([&](Index, const Vector& p) { box.extend(p); });
    return box;
  }

 private:
  [[nodiscard]] const Model& model() const { return static_cast<const Model&>(*this); }
  [[nodiscard]] Model& model() { return static_cast<Model&>(*this); }
};

}  // namespace chainslam
