#include "registration/peers/small_gicp.hpp"

#include <algorithm>
#include <iostream>  // which its headers need and do not include
#include <utility>

#include <small_gicp/ann/gaussian_voxelmap.hpp>
#include <small_gicp/ann/kdtree.hpp>
#include <small_gicp/factors/gicp_factor.hpp>
#include <small_gicp/factors/icp_factor.hpp>
#include <small_gicp/factors/plane_icp_factor.hpp>
#include <small_gicp/points/point_cloud.hpp>
#include <small_gicp/registration/registration.hpp>
#include <small_gicp/util/downsampling.hpp>
#include <small_gicp/util/normal_estimation.hpp>

namespace chainslam::bench {

using Tree = small_gicp::KdTree<small_gicp::PointCloud>;

struct SmallGicpCloud::Parts {
  small_gicp::PointCloud::Ptr cloud;
  std::unique_ptr<Tree> tree;
  std::unique_ptr<small_gicp::GaussianVoxelMap> voxels;
};

SmallGicpCloud::SmallGicpCloud(std::unique_ptr<Parts> parts) : parts_(std::move(parts)) {}
SmallGicpCloud::SmallGicpCloud(const Positions& points)
    : parts_(new Parts{std::make_shared<small_gicp::PointCloud>(points), nullptr, nullptr}) {}
SmallGicpCloud::SmallGicpCloud(SmallGicpCloud&&) noexcept = default;
SmallGicpCloud& SmallGicpCloud::operator=(SmallGicpCloud&&) noexcept = default;
SmallGicpCloud::~SmallGicpCloud() = default;

std::size_t SmallGicpCloud::size() const { return parts_->cloud->size(); }

Positions SmallGicpCloud::positions() const {
  Positions result;
  for (const Eigen::Vector4d& p : parts_->cloud->points) result.emplace_back(p.head<3>().cast<float>());
  return result;
}

Positions SmallGicpCloud::normals() const {
  Positions result;
  for (const Eigen::Vector4d& n : parts_->cloud->normals) result.emplace_back(n.head<3>().cast<float>());
  return result;
}

std::vector<Eigen::Matrix3d> SmallGicpCloud::covariances() const {
  std::vector<Eigen::Matrix3d> result;
  for (const Eigen::Matrix4d& covariance : parts_->cloud->covs) result.emplace_back(covariance.topLeftCorner<3, 3>());
  return result;
}

SmallGicpCloud SmallGicpCloud::downsampled(double voxel) const {
  auto parts = std::make_unique<Parts>();
  parts->cloud = small_gicp::voxelgrid_sampling(*parts_->cloud, voxel);
  return SmallGicpCloud(std::move(parts));
}

void SmallGicpCloud::build_tree() { parts_->tree = std::make_unique<Tree>(parts_->cloud); }

void SmallGicpCloud::estimate_normals_and_covariances(int neighbors) {
  small_gicp::estimate_normals_covariances(*parts_->cloud, *parts_->tree, neighbors);
}

void SmallGicpCloud::build_voxel_map(double resolution) {
  parts_->voxels = std::make_unique<small_gicp::GaussianVoxelMap>(resolution);
  parts_->voxels->insert(*parts_->cloud);
}

double SmallGicpCloud::sum_of_squared_distances_to(const SmallGicpCloud& target) const {
  double sum = 0;
  for (const Eigen::Vector4d& query : parts_->cloud->points) {
    std::size_t index = 0;
    double squared = 0;
    target.parts_->tree->nearest_neighbor_search(query, &index, &squared);
    sum += squared;
  }
  return sum;
}

namespace {

template <class Factor, class Optimizer, class TargetCloud, class TargetSearch>
PeerPose align(const SmallGicpCloud& source, const TargetCloud& target, const TargetSearch& search,
               const PeerTransform& guess, const SmallGicpSettings& settings) {
  small_gicp::Registration<Factor, small_gicp::SerialReduction, small_gicp::NullFactor, small_gicp::DistanceRejector,
                           Optimizer>
      registration;
  registration.rejector.max_dist_sq = settings.max_distance * settings.max_distance;
  registration.criteria.translation_eps = settings.translation_eps;
  registration.criteria.rotation_eps = settings.rotation_eps;
  registration.optimizer.max_iterations = settings.max_iterations;
  const small_gicp::RegistrationResult result =
      registration.align(target, *source.parts().cloud, search, Eigen::Isometry3d(guess));
  return {PeerTransform(result.T_target_source), static_cast<int>(result.iterations) + 1, result.converged,
          result.num_inliers};
}

template <class Factor, class... Rest>
PeerPose align_by(const SmallGicpSettings& settings, const SmallGicpCloud& source, const Rest&... rest) {
  if (settings.gauss_newton) return align<Factor, small_gicp::GaussNewtonOptimizer>(source, rest..., settings);
  return align<Factor, small_gicp::LevenbergMarquardtOptimizer>(source, rest..., settings);
}

}  // namespace

PeerPose small_gicp_align(SmallGicpMetric metric, const SmallGicpCloud& source, const SmallGicpCloud& target,
                          const PeerTransform& guess, const SmallGicpSettings& settings) {
  const SmallGicpCloud::Parts& parts = target.parts();
  switch (metric) {
    case SmallGicpMetric::point:
      return align_by<small_gicp::ICPFactor>(settings, source, *parts.cloud, *parts.tree, guess);
    case SmallGicpMetric::plane:
      return align_by<small_gicp::PointToPlaneICPFactor>(settings, source, *parts.cloud, *parts.tree, guess);
    case SmallGicpMetric::gicp:
      return align_by<small_gicp::GICPFactor>(settings, source, *parts.cloud, *parts.tree, guess);
    case SmallGicpMetric::vgicp:
      break;
  }
  return align_by<small_gicp::GICPFactor>(settings, source, *parts.voxels, *parts.voxels, guess);
}

SmallGicpCloud small_gicp_prepared(const Positions& points, double voxel, int neighbors) {
  SmallGicpCloud cloud = SmallGicpCloud(points).downsampled(voxel);
  cloud.build_tree();
  cloud.estimate_normals_and_covariances(neighbors);
  return cloud;
}

PeerPose small_gicp_scan_to_submap(const Positions& scan, double voxel, const SmallGicpCloud& submap,
                                   const PeerTransform& guess, const SmallGicpSettings& settings) {
  return small_gicp_align(SmallGicpMetric::gicp, small_gicp_prepared(scan, voxel), submap, guess, settings);
}

}  // namespace chainslam::bench
