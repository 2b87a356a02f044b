#pragma once

#include <cassert>
#include <limits>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/compiled.hpp"
#include "chainslam/search/concepts.hpp"
#include "chainslam/search/kd_tree.hpp"

namespace chainslam {

/// A cloud together with the search over its points: what registration takes as a target.
///
/// Indices, positions and normals are those of `cloud()`, which does not change; replace the whole to change it.
/// Searching needs no normals; `normal(i)` does.
template <class SearchType = KdTree<float>>
class IndexedCloud {
  static_assert(
      NearestNeighborSearch<SearchType>,
      "IndexedCloud: Search needs knn, within, position and size, as in KdTree; see chainslam/search/concepts.hpp");

 public:
  using Search = SearchType;                    ///< the search over the points
  using Scalar = typename Search::Scalar;       ///< number type
  using Vector3 = Eigen::Matrix<Scalar, 3, 1>;  ///< a point

  IndexedCloud() = default;
  /// Builds the search, in O(n log n).
  explicit IndexedCloud(PointCloud<Scalar> cloud) : cloud_(std::move(cloud)), search_(cloud_) {}
  /// With a search that was built before, over the same positions.
  IndexedCloud(PointCloud<Scalar> cloud, Search search) : cloud_(std::move(cloud)), search_(std::move(search)) {}

  [[nodiscard]] const PointCloud<Scalar>& cloud() const { return cloud_; }  ///< the cloud
  [[nodiscard]] const Search& search() const { return search_; }            ///< the search over the points
  /// Points that can be found: those of the cloud that are finite.
  [[nodiscard]] std::size_t size() const { return search_.size(); }
  [[nodiscard]] bool has_normals() const { return cloud_.has_normals(); }  ///< whether there is a normal for each point

  /// Position of point i, metres.
  [[nodiscard]] const Vector3& position(Index i) const { return cloud_.positions[static_cast<std::size_t>(i)]; }
  /// Unit normal of point i; the cloud must have normals.
  [[nodiscard]] const Vector3& normal(Index i) const {
    assert(cloud_.has_normals());
    return cloud_.normals[static_cast<std::size_t>(i)];
  }

  /// The k nearest points as a vector, as `SearchBase::knn`.
  [[nodiscard]] std::vector<Neighbor<Scalar>> knn(
      const Vector3& query, Index k, Scalar max_distance = std::numeric_limits<Scalar>::infinity()) const requires
      requires(const Search& search) {
    search.knn(query, k, max_distance);
  }
  { return search_.knn(query, k, max_distance); }
  /// All points with distance <= `radius` (metres) as a vector, ascending by distance, as `SearchBase::radius`.
  [[nodiscard]] std::vector<Neighbor<Scalar>> radius(const Vector3& query, Scalar radius) const requires
      requires(const Search& search) {
    search.radius(query, radius);
  }
  { return search_.radius(query, radius); }

  /// As `NearestNeighborSearch` has it.
  Index knn(const Vector3& query, std::span<Neighbor<Scalar>> out,
            Scalar max_distance = std::numeric_limits<Scalar>::infinity()) const {
    return search_.knn(query, out, max_distance);
  }

  /// As `SeededSearch` has it.
  Index knn(const Vector3& query, std::span<Neighbor<Scalar>> out, Scalar max_distance,
            std::span<const Neighbor<Scalar>> seeds) const requires SeededSearch<Search> {
    return search_.knn(query, out, max_distance, seeds);
  }

  /// As `FixedSizeSearch` has it.
  template <int K>
    requires FixedSizeSearch<Search>
  [[nodiscard]] KNearest<Scalar, K> knn(const Vector3& query,
                                        Scalar max_distance = std::numeric_limits<Scalar>::infinity()) const {
    return search_.template knn<K>(query, max_distance);
  }

  /// Replaces `out` by all points with distance <= `radius` (metres), in any order.
  void within(const Vector3& query, Scalar radius, std::vector<Neighbor<Scalar>>& out) const {
    search_.within(query, radius, out);
  }

 private:
  PointCloud<Scalar> cloud_;
  Search search_;
};
static_assert(OrientedSearch<IndexedCloud<>> && SeededSearch<IndexedCloud<>> && FixedSizeSearch<IndexedCloud<>>);

#ifdef CHAINSLAM_COMPILED
extern template KdTree<float>::KdTree(const PointCloud<float>&);
#endif

}  // namespace chainslam
