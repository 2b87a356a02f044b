#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <limits>
#include <span>
#include <vector>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/search/concepts.hpp"
#include "chainslam/search/detail/nearest_list.hpp"
#include "chainslam/search/detail/point_source.hpp"
#include "chainslam/search/detail/radius_list.hpp"
#include "chainslam/search/detail/regions.hpp"

namespace chainslam::detail {

/// The verbs of searching, for a model that says how a collector goes through its points:
/// - `search(query, found)`, which offers every point with squared distance < `found.bound()`,
/// - `contains(i)`, whether i is the index of a point, and `position(i)`,
/// - `max_search_radius()`, if there is one.
template <class Model, class ScalarType, int Dim>
class SearchVerbs {
 public:
  using Scalar = ScalarType;
  using Vector = Eigen::Matrix<Scalar, Dim, 1>;
  static constexpr int dimension = Dim;

  /// See `NearestNeighborSearch`. A bound in `max_distance` makes it faster.
  Index knn(const Vector& query, std::span<Neighbor<Scalar>> out,
            Scalar max_distance = std::numeric_limits<Scalar>::infinity()) const {
    return nearest(query, out, distance_bound(limited(max_distance)));
  }

  /// See `SeededSearch`.
  Index knn(const Vector& query, std::span<Neighbor<Scalar>> out, Scalar max_distance,
            std::span<const Neighbor<Scalar>> seeds) const {
    const Scalar bound = distance_bound(limited(max_distance));
    return nearest(query, out, std::min(bound, seed_bound(query, seeds, out.size())));
  }

  /// See `FixedSizeSearch`.
  template <int K>
  [[nodiscard]] KNearest<Scalar, K> knn(const Vector& query,
                                        Scalar max_distance = std::numeric_limits<Scalar>::infinity()) const {
    FixedNearestList<Scalar, K> found(distance_bound(limited(max_distance)));
    model().search(query, found);
    return found.result();
  }

  void within(const Vector& query, Scalar radius, std::vector<Neighbor<Scalar>>& out) const {
    RadiusList<Scalar> found(out, distance_bound(limited(radius)));
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
    if (out.size() <= static_cast<std::size_t>(SmallNearest<Scalar>::max_k)) {
      SmallNearest<Scalar> found(out.size(), bound);
      model().search(query, found);
      return found.write(out);
    }
    NearestList<Scalar> found(out, bound);
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
    return enough ? next_above(farthest * rounding) : std::numeric_limits<Scalar>::infinity();
  }
};

/// The verbs of `IncrementalSearch`, for a model that says, beside the above, how to
/// - `insert(p)` and `for_each_point(visit)`,
/// - `erase_region(region)`: erase the region's points and say how many went,
/// - `visit_region(region, visit)`: call `visit(index, position)` for each of the region's points.
template <class Model, class ScalarType, int Dim>
class IncrementalVerbs : public SearchVerbs<Model, ScalarType, Dim> {
  using Base = SearchVerbs<Model, ScalarType, Dim>;

 public:
  using typename Base::Scalar;
  using typename Base::Vector;
  using Box = Eigen::AlignedBox<Scalar, Dim>;

  /// Inserts the points in their order. Returns by how much `size()` grew.
  template <PointSource<Dim> Points>
  Index insert(const Points& points) {
    const std::size_t before = model().size();
    const Index count = source_size<Dim>(points);
    for (Index i = 0; i < count; ++i) model().insert(source_position<Scalar, Dim>(points, i));
    return static_cast<Index>(model().size() - before);
  }

  /// Erases the points equal to p. Returns how many went.
  Index erase_point(const Vector& p) { return erase_inside(Box(p, p)); }
  /// Erases the points of the closed box. Returns how many went.
  Index erase_inside(const Box& box) { return model().erase_region(BoxRegion<Scalar, Dim>{box}); }
  /// Erases the points outside the closed box. Returns how many went.
  Index erase_outside(const Box& box) { return model().erase_region(Complement<BoxRegion<Scalar, Dim>>{{box}}); }
  /// Erases the points whose distance from `center` is below `radius` (metres). Returns how many went.
  Index erase_nearer_than(const Vector& center, Scalar radius) {
    return model().erase_region(BallRegion<Scalar, Dim>{center, radius > 0 ? radius * radius : 0});
  }
  /// Erases the points whose distance from `center` exceeds `radius` (metres). Returns how many went.
  Index erase_farther_than(const Vector& center, Scalar radius) {
    return model().erase_region(Complement<BallRegion<Scalar, Dim>>{{center, distance_bound(radius)}});
  }

  /// Replaces `out` by the indices of the points in the closed box.
  void within_box(const Box& box, std::vector<Index>& out) const {
    out.clear();
    model().visit_region(BoxRegion<Scalar, Dim>{box}, [&](Index i, const Vector&) { out.push_back(i); });
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

}  // namespace chainslam::detail
