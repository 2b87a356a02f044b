#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include "chainslam/cloud/cell_table.hpp"
#include "chainslam/cloud/plane_fit.hpp"
#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/slam/connected_components.hpp"

namespace chainslam {

/// How flat pieces of surface are found. Defaults: configuration of STD, BTC and LAMM for 32 lasers.
struct SurfacePlaneOptions {
  double voxel_size = 2.0;      ///< metres
  Index more_than_points = 10;  ///< in a voxel
  double max_variance = 0.01;   ///< m^2 along the normal: the smallest eigenvalue of the points' covariance
  double merge_normal = 0.1;    ///< two pieces are of one plane if their normals differ by less than this, either sign,
  double merge_distance = 0.3;  ///< and each centre is nearer the other's plane than this, metres
};

/// A flat piece of surface: the points of one voxel, or of several that lie in one plane.
struct SurfacePlane {
  Eigen::Vector3d center = Eigen::Vector3d::Zero();      ///< mean of its points, metres
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();     ///< unit, sign not defined
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();  ///< of its points, m^2
  Index points = 0;

  /// From a point to the plane, metres.
  [[nodiscard]] double distance(const Eigen::Vector3d& p) const { return std::abs(normal.dot(p - center)); }
};

/// How much two normals of unknown sign differ: length of the difference.
[[nodiscard]] inline double normal_difference(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::min((a - b).norm(), (a + b).norm());
}

namespace detail {

/// Sums over the points of a voxel about its centre, so that no digits are lost far from the origin.
struct VoxelMoments {
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  Eigen::Matrix3d squares = Eigen::Matrix3d::Zero();
  Index points = 0;
};

[[nodiscard]] inline std::vector<VoxelMoments> voxel_moments(const PointCloud<float>& cloud, double voxel_size) {
  CellTable table;
  std::vector<VoxelMoments> voxels;
  for (const Eigen::Vector3f& point : cloud.positions) {
    const Eigen::Vector3d p = point.cast<double>();
    const std::optional<Cell> cell = cell_of(p / voxel_size);
    if (!cell) continue;
    const auto [index, is_new] = table.insert(*cell, to_index(voxels.size()));
    if (is_new) voxels.push_back({.middle = voxel_size * (Eigen::Vector3d(cell->x, cell->y, cell->z).array() + 0.5)});
    VoxelMoments& voxel = voxels[static_cast<std::size_t>(index)];
    const Eigen::Vector3d offset = p - voxel.middle;
    voxel.sum += offset;
    voxel.squares += offset * offset.transpose();
    ++voxel.points;
  }
  return voxels;
}

/// The plane of least squares through the points of two sets of planes, from their means and covariances.
[[nodiscard]] inline SurfacePlane joined(const SurfacePlane& a, const SurfacePlane& b) {
  SurfacePlane both;
  both.points = a.points + b.points;
  const double share = static_cast<double>(b.points) / static_cast<double>(both.points);
  const Eigen::Vector3d between = b.center - a.center;
  both.center = a.center + share * between;
  both.covariance =
      (1 - share) * a.covariance + share * b.covariance + share * (1 - share) * between * between.transpose();
  return both;
}

[[nodiscard]] inline bool in_one_plane(const SurfacePlane& a, const SurfacePlane& b,
                                       const SurfacePlaneOptions& options) {
  return normal_difference(a.normal, b.normal) < options.merge_normal &&
         a.distance(b.center) < options.merge_distance && b.distance(a.center) < options.merge_distance;
}

}  // namespace detail

/// The flat voxels of a cloud.
/// @param cloud  metres, any frame; points that are not finite are skipped.
[[nodiscard]] inline std::vector<SurfacePlane> surface_planes(const PointCloud<float>& cloud,
                                                              const SurfacePlaneOptions& options = {}) {
  std::vector<SurfacePlane> planes;
  for (const detail::VoxelMoments& voxel : detail::voxel_moments(cloud, options.voxel_size)) {
    if (voxel.points <= options.more_than_points) continue;
    const double share = 1.0 / static_cast<double>(voxel.points);
    const Eigen::Vector3d mean = share * voxel.sum;
    const Eigen::Matrix3d covariance = share * voxel.squares - mean * mean.transpose();
    const PlaneFit fit = fit_plane(Eigen::Vector3d(voxel.middle + mean), covariance);
    if (!fit.good() || fit.eigenvalues[0] >= options.max_variance) continue;
    planes.push_back({.center = fit.centroid, .normal = fit.normal, .covariance = covariance, .points = voxel.points});
  }
  return planes;
}

/// The plane that most points lie in: pieces of one plane, and pieces that they have in common, are joined; the largest
/// is taken. Outdoors that is the ground.
/// @returns none if there are no pieces.
[[nodiscard]] inline std::optional<SurfacePlane> largest_plane(const std::vector<SurfacePlane>& pieces,
                                                               const SurfacePlaneOptions& options = {}) {
  if (pieces.empty()) return std::nullopt;
  ConnectedComponents components(to_index(pieces.size()));
  for (std::size_t i = 0; i < pieces.size(); ++i)
    for (std::size_t j = i + 1; j < pieces.size(); ++j)
      if (detail::in_one_plane(pieces[i], pieces[j], options)) components.connect(to_index(i), to_index(j));
  std::vector<SurfacePlane> merged(pieces.size());
  for (std::size_t i = 0; i < pieces.size(); ++i) {
    SurfacePlane& whole = merged[static_cast<std::size_t>(components.component_of(to_index(i)))];
    whole = whole.points == 0 ? pieces[i] : detail::joined(whole, pieces[i]);
  }
  SurfacePlane largest = *std::ranges::max_element(merged, {}, &SurfacePlane::points);
  const PlaneFit fit = fit_plane(largest.center, largest.covariance);
  largest.normal = fit.normal;
  return largest;
}

}  // namespace chainslam
