#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <limits>
#include <span>
#include <stdexcept>
#include <utility>
#include <vector>

#include "chainslam/cloud/traits.hpp"
#include "chainslam/registration/detail/source_columns.hpp"
#include "chainslam/search/concepts.hpp"
#include "chainslam/search/kd_tree.hpp"

namespace chainslam {

/// Points with a covariance each, as `estimate_normals` gives them or a sensor's model has them: a source of
/// `DistributionToDistribution`.
struct GaussianCloud {
  std::vector<Eigen::Vector3f> positions{};         ///< metres
  std::vector<std::array<float, 6>> covariances{};  ///< xx, xy, xz, yy, yz, zz; as long as `positions`
};

/// A `GaussianCloud` is a cloud with covariances.
template <>
struct CloudTraits<GaussianCloud> {
  static std::size_t size(const GaussianCloud& cloud) { return cloud.positions.size(); }  ///< number of points
  /// Position of point i, metres.
  static const Eigen::Vector3f& position(const GaussianCloud& cloud, std::size_t i) { return cloud.positions[i]; }
  /// Covariance of point i.
  static Eigen::Matrix3f covariance(const GaussianCloud& cloud, std::size_t i) {
    const auto& [xx, xy, xz, yy, yz, zz] = cloud.covariances[i];
    Eigen::Matrix3f matrix;
    matrix << xx, xy, xz, xy, yy, yz, xz, yz, zz;
    return matrix;
  }
};
static_assert(DistributedCloud<GaussianCloud>);

/// A `GaussianCloud` together with the search over its points: a target of `DistributionToDistribution` that matches
/// nearest points, where a `GaussianVoxelMap` matches voxels.
template <class SearchType = KdTree<float>>
class IndexedGaussians {
  static_assert(
      NearestNeighborSearch<SearchType>,
      "IndexedGaussians: Search needs knn, within, position and size, as in KdTree; see chainslam/search/concepts.hpp");

 public:
  using Search = SearchType;  ///< the search over the points
  using Scalar = float;       ///< number type

  IndexedGaussians() = default;
  /// @throws std::invalid_argument if there is not a covariance a point.
  explicit IndexedGaussians(GaussianCloud cloud) : cloud_(std::move(cloud)), search_(cloud_.positions) {
    if (cloud_.covariances.size() != cloud_.positions.size())
      throw std::invalid_argument("IndexedGaussians: needs a covariance for each point");
  }

  [[nodiscard]] const GaussianCloud& cloud() const { return cloud_; }  ///< the cloud
  [[nodiscard]] const Search& search() const { return search_; }       ///< the search over the points
  /// Points that can be found: those of the cloud that are finite.
  [[nodiscard]] std::size_t size() const { return search_.size(); }
  /// Position of point i, metres.
  [[nodiscard]] const Eigen::Vector3f& position(Index i) const { return cloud_.positions[static_cast<std::size_t>(i)]; }
  /// Covariance of point i.
  [[nodiscard]] Eigen::Matrix3f covariance(Index i) const {
    return CloudTraits<GaussianCloud>::covariance(cloud_, static_cast<std::size_t>(i));
  }

  /// As `NearestNeighborSearch` has it.
  Index knn(const Eigen::Vector3f& query, std::span<Neighbor<float>> out,
            float max_distance = std::numeric_limits<float>::infinity()) const {
    return search_.knn(query, out, max_distance);
  }
  /// As `NearestNeighborSearch` has it.
  void within(const Eigen::Vector3f& query, float radius, std::vector<Neighbor<float>>& out) const {
    search_.within(query, radius, out);
  }

 private:
  GaussianCloud cloud_;
  Search search_;
};
static_assert(NearestNeighborSearch<IndexedGaussians<>>);

}  // namespace chainslam
