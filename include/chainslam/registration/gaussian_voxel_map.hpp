#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <limits>
#include <optional>
#include <span>
#include <stdexcept>
#include <utility>
#include <vector>

#include "chainslam/cloud/cell_table.hpp"
#include "chainslam/cloud/concepts.hpp"
#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/registration/concepts.hpp"
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

/// Size of the voxels, and which of them count.
struct GaussianVoxelMapOptions {
  double voxel_size = 1.0;  ///< edge, metres
  /// Voxels that a point may be matched with: 1, its own; 7, those that share a face with it, too; 27, all around it.
  /// Of several the one whose mean is nearest. With its own alone, a wall along voxels' faces loses the points that lie
  /// beyond, and the others push it farther off.
  Index neighborhood = 7;
  double thickness = 1e-3;  ///< of the discs made from normals, see `PlaneToPlane`
};

/// A target of Gaussians, one a voxel: the mean of the voxel's points and the mean of their covariances (Koide et al.
/// 2021). Matching a point with it is one look into a hash, which makes registration fast and its reach wide.
///
/// Grows by clouds. Voxels are numbered in the order in which they were first met; the same clouds in the same order
/// give bit-identical results. Const calls may run on several threads.
class GaussianVoxelMap {
 public:
  using Scalar = double;                    ///< number type
  using Options = GaussianVoxelMapOptions;  ///< its settings

  /// @throws std::invalid_argument if an option is out of range.
  explicit GaussianVoxelMap(const Options& options = {}) : options_(options), inverse_size_(1.0 / options.voxel_size) {
    if (!(options.voxel_size > 0) || !is_finite(options.voxel_size) || !is_finite(inverse_size_))
      throw std::invalid_argument("GaussianVoxelMap: voxel_size must be positive and finite");
    if (options.neighborhood != 1 && options.neighborhood != 7 && options.neighborhood != 27)
      throw std::invalid_argument("GaussianVoxelMap: neighborhood must be 1, 7 or 27");
    if (!(options.thickness > 0 && options.thickness <= 1))
      throw std::invalid_argument("GaussianVoxelMap: thickness must lie in (0, 1]");
  }

  /// Adds the cloud's points with their covariances, or with discs across their normals; a point that has neither is a
  /// ball. NaN points are left out.
  /// @param T_map_cloud  where the cloud stands in the map.
  template <Cloud Points>
  void insert(const Points& cloud, const SE3d& T_map_cloud = {}) {
    const Eigen::Matrix3d R = T_map_cloud.rotation().matrix();
    for (std::size_t i = 0; i < cloud_size(cloud); ++i) {
      const Eigen::Vector3d p = T_map_cloud * chainslam::position(cloud, i);
      const std::optional<Cell> cell = cell_of(p * inverse_size_);
      if (!cell) continue;
      add(*cell, p, R * covariance_of(cloud, i) * R.transpose());
    }
  }

  [[nodiscard]] const Options& options() const { return options_; }  ///< its settings
  /// Voxels that hold points.
  [[nodiscard]] std::size_t size() const { return voxels_.size(); }
  /// Mean of a voxel's points, metres.
  [[nodiscard]] const Eigen::Vector3d& position(Index i) const { return at(i).mean; }
  /// Mean of their covariances.
  [[nodiscard]] const Eigen::Matrix3d& covariance(Index i) const { return at(i).covariance; }
  /// Points in a voxel.
  [[nodiscard]] Index count(Index i) const { return at(i).count; }

  /// The voxel that a point goes with, or -1. See `MatchingTarget`.
  [[nodiscard]] Index match(const Eigen::Vector3d& query, double max_distance) const {
    const std::optional<Cell> cell = cell_of(query * inverse_size_);
    if (!cell) return -1;
    Match best{-1, max_distance * max_distance};
    look(*cell, query, best);
    if (options_.neighborhood == 7) {
      for (const int step : {-1, 1}) {
        look({cell->x + step, cell->y, cell->z}, query, best);
        look({cell->x, cell->y + step, cell->z}, query, best);
        look({cell->x, cell->y, cell->z + step}, query, best);
      }
    } else if (options_.neighborhood == 27) {
      for (int dx = -1; dx <= 1; ++dx)
        for (int dy = -1; dy <= 1; ++dy)
          for (int dz = -1; dz <= 1; ++dz)
            if (dx != 0 || dy != 0 || dz != 0) look({cell->x + dx, cell->y + dy, cell->z + dz}, query, best);
    }
    return best.index;
  }

 private:
  struct Voxel {
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    Eigen::Matrix3d covariance = zeros<Eigen::Matrix3d>();
    Index count = 0;
  };
  struct Match {
    Index index;
    double squared_distance;
  };

  [[nodiscard]] const Voxel& at(Index i) const { return voxels_[static_cast<std::size_t>(i)]; }

  template <class Points>
  [[nodiscard]] Eigen::Matrix3d covariance_of(const Points& cloud, std::size_t i) const {
    if constexpr (DistributedCloud<Points>) {
      const auto& c = CloudTraits<Points>::covariance(cloud, i);
      Eigen::Matrix3d covariance;
      for (int row = 0; row < 3; ++row)
        for (int column = 0; column < 3; ++column) covariance(row, column) = static_cast<double>(c(row, column));
      return covariance;
    } else {
      Eigen::Vector3d n = Eigen::Vector3d::Zero();
      if (carries_normals(cloud)) n = normal(cloud, i);
      if (!is_finite(n)) n.setZero();
      return Eigen::Matrix3d::Identity() - (1.0 - options_.thickness) * n * n.transpose();
    }
  }

  /// Means as they grow: no sum whose rounding depends on the distance from the origin.
  void add(const Cell& cell, const Eigen::Vector3d& p, const Eigen::Matrix3d& covariance) {
    const auto [index, is_new] = table_.insert(cell, to_index(voxels_.size(), "voxels"));
    if (is_new) voxels_.emplace_back();
    Voxel& voxel = voxels_[static_cast<std::size_t>(index)];
    const double share = 1.0 / static_cast<double>(++voxel.count);
    voxel.mean = sum_of(voxel.mean, scaled(share, difference_of(p, voxel.mean)));
    voxel.covariance = sum_of(voxel.covariance, scaled(share, difference_of(covariance, voxel.covariance)));
  }

  void look(const Cell& cell, const Eigen::Vector3d& query, Match& best) const {
    const Index index = table_.find(cell);
    if (index < 0) return;
    const double squared = difference_of(at(index).mean, query).squaredNorm();
    if (squared < best.squared_distance || (best.index < 0 && squared == best.squared_distance))
      best = {index, squared};
  }

  Options options_;
  double inverse_size_;
  CellTable table_;
  std::vector<Voxel> voxels_;
};
static_assert(MatchingTarget<GaussianVoxelMap>);

}  // namespace chainslam
