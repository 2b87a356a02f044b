#pragma once

#include <cmath>
#include <limits>
#include <span>
#include <vector>

#include "chainslam/cloud/plane_fit.hpp"
#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/registration/feature_registration.hpp"
#include "chainslam/registration/icp.hpp"
#include "chainslam/search/indexed_cloud.hpp"

namespace chainslam::experiments {

/// How a cloud lies on a reference, metres: root mean square of the distances from each point to the nearest of the
/// reference. NaN where registration found nothing.
struct CloudErrors {
  double as_aligned = std::numeric_limits<double>::quiet_NaN();  ///< by the trajectory's own alignment
  double after_ransac = std::numeric_limits<double>::quiet_NaN();
  double after_icp = std::numeric_limits<double>::quiet_NaN();
  double thickness = std::numeric_limits<double>::quiet_NaN();  ///< of the cloud itself, see `thickness_of`
  Index points = 0;
};

inline double rms_distance(const PointCloud<float>& cloud, const SE3d& T, const KdTree<float>& reference) {
  const PointCloud<float> placed = transformed(cloud, T);
  double sum = 0;
  for (const Eigen::Vector3f& point : placed.positions) {
    Neighbor<float> nearest;
    reference.knn(point, std::span(&nearest, 1));
    sum += static_cast<double>(nearest.squared_distance);
  }
  return std::sqrt(sum / static_cast<double>(placed.size()));
}

/// How thick surfaces are, metres: the mean over points of the least standard deviation of those within 1 m of one.
/// Walls that are drawn twice are thick, and so are leaves and corners, in any map.
/// @param step  every so manyth point is looked at.
inline double thickness_of(const PointCloud<float>& cloud, const KdTree<float>& tree, std::size_t step) {
  constexpr float radius = 1.0F;
  constexpr std::size_t least = 10;
  double sum = 0, count = 0;
  std::vector<Neighbor<float>> near;
  std::vector<Eigen::Vector3f> points;
  for (std::size_t i = 0; i < cloud.size(); i += step) {
    tree.within(cloud.positions[i], radius, near);
    if (near.size() < least) continue;
    points.clear();
    for (const Neighbor<float>& one : near) points.push_back(cloud.positions[static_cast<std::size_t>(one.index)]);
    sum += std::sqrt(fit_plane(points).eigenvalues[0]);
    ++count;
  }
  return count > 0 ? sum / count : std::numeric_limits<double>::quiet_NaN();
}

/// Registers a cloud to its reference, without a guess by features and RANSAC, then by ICP: fixed seeds and parameters.
/// @param T_reference_cloud  where the cloud lies by the trajectory's alignment; registration does not use it.
template <Executor Exec = Serial>
CloudErrors cloud_errors(const PointCloud<float>& cloud, const PointCloud<float>& reference,
                         const SE3d& T_reference_cloud, const Exec& executor = {}) {
  constexpr std::size_t least = 100;
  CloudErrors errors{.points = to_index(cloud.size())};
  if (cloud.size() < least || reference.size() < least) return errors;
  const IndexedCloud<> target(reference);
  errors.as_aligned = rms_distance(cloud, T_reference_cloud, target.search());
  errors.thickness = thickness_of(cloud, KdTree<float>(cloud), 4);
  FeatureRegistration<> features;
  features.estimator.max_iterations = 10'000;  // as the paper's release has it
  const GlobalAlignResult found = features.align(cloud, reference, executor);
  if (!found.found()) return errors;
  errors.after_ransac = rms_distance(cloud, found.T_target_source, target.search());
  const Icp<PointToPoint> icp{.max_iterations = 100, .max_distance = 2.0};
  const AlignResult refined = icp.align(cloud, target, found.T_target_source, executor);
  errors.after_icp = rms_distance(cloud, refined.T_target_source, target.search());
  return errors;
}

}  // namespace chainslam::experiments
