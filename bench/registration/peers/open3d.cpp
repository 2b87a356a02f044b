#include "registration/peers/open3d.hpp"

#include <omp.h>
#include <open3d/geometry/KDTreeFlann.h>
#include <open3d/geometry/PointCloud.h>
#include <open3d/pipelines/registration/CorrespondenceChecker.h>
#include <open3d/pipelines/registration/Feature.h>
#include <open3d/pipelines/registration/GeneralizedICP.h>
#include <open3d/pipelines/registration/Registration.h>
#include <open3d/utility/Random.h>

#include <algorithm>
#include <cmath>

namespace chainslam::bench {

namespace o3d = open3d::pipelines::registration;

struct Open3dCloud::Parts {
  open3d::geometry::PointCloud cloud;
  std::shared_ptr<o3d::Feature> features;
};

Open3dCloud::Open3dCloud(std::unique_ptr<Parts> parts) : parts_(std::move(parts)) {}
Open3dCloud::Open3dCloud(Open3dCloud&&) noexcept = default;
Open3dCloud& Open3dCloud::operator=(Open3dCloud&&) noexcept = default;
Open3dCloud::~Open3dCloud() = default;

Open3dCloud::Open3dCloud(const Positions& points, const Positions& normals) : parts_(new Parts) {
  omp_set_num_threads(1);
  for (const Eigen::Vector3f& p : points) parts_->cloud.points_.emplace_back(p.cast<double>());
  for (const Eigen::Vector3f& n : normals) parts_->cloud.normals_.emplace_back(n.cast<double>());
}

std::size_t Open3dCloud::size() const { return parts_->cloud.points_.size(); }

namespace {

Positions in_float(const std::vector<Eigen::Vector3d>& vectors) {
  Positions result;
  for (const Eigen::Vector3d& v : vectors) result.emplace_back(v.cast<float>());
  return result;
}

}  // namespace

Positions Open3dCloud::positions() const { return in_float(parts_->cloud.points_); }
Positions Open3dCloud::normals() const { return in_float(parts_->cloud.normals_); }

PeerFeatures Open3dCloud::features() const {
  PeerFeatures result;
  for (Eigen::Index i = 0; i < parts_->features->data_.cols(); ++i)
    Eigen::Map<Eigen::Matrix<float, 33, 1>>(result.emplace_back().data()) =
        parts_->features->data_.col(i).cast<float>();
  return result;
}

Open3dCloud Open3dCloud::downsampled(double voxel) const {
  auto parts = std::make_unique<Parts>();
  parts->cloud = std::move(*parts_->cloud.VoxelDownSample(voxel));
  return Open3dCloud(std::move(parts));
}

void Open3dCloud::estimate_normals(int neighbors, double radius, const Eigen::Vector3f& viewpoint) {
  parts_->cloud.EstimateNormals(open3d::geometry::KDTreeSearchParamHybrid(radius, neighbors));
  parts_->cloud.OrientNormalsTowardsCameraLocation(viewpoint.cast<double>());
}

void Open3dCloud::estimate_fpfh(double radius, int neighbors) {
  parts_->features =
      o3d::ComputeFPFHFeature(parts_->cloud, open3d::geometry::KDTreeSearchParamHybrid(radius, neighbors));
}

namespace {

std::vector<int> nearest_features(const o3d::Feature& from, const o3d::Feature& to) {
  const open3d::geometry::KDTreeFlann tree(to);
  std::vector<int> nearest(from.Num()), found(1);
  std::vector<double> squared(1);
  for (std::size_t i = 0; i < nearest.size(); ++i) {
    tree.SearchKNN(Eigen::VectorXd(from.data_.col(static_cast<Eigen::Index>(i))), 1, found, squared);
    nearest[i] = found[0];
  }
  return nearest;
}

PeerPose answer(const o3d::RegistrationResult& registration) {
  PeerPose result;
  result.T_target_source.matrix() = registration.transformation_;
  result.converged = !registration.correspondence_set_.empty();
  result.inliers = registration.correspondence_set_.size();
  return result;
}

}  // namespace

IndexPairs open3d_matches(const Open3dCloud& source, const Open3dCloud& target) {
  const std::vector<int> there = nearest_features(*source.parts().features, *target.parts().features);
  const std::vector<int> back = nearest_features(*target.parts().features, *source.parts().features);
  IndexPairs matches;
  for (std::size_t i = 0; i < there.size(); ++i)
    if (back[static_cast<std::size_t>(there[i])] == static_cast<int>(i))
      matches.emplace_back(static_cast<int>(i), there[i]);
  return matches;
}

PeerPose open3d_ransac(const Open3dCloud& source, const Open3dCloud& target, const IndexPairs& matches,
                       double max_distance, int max_iterations, unsigned seed) {
  open3d::utility::random::Seed(static_cast<int>(seed));
  o3d::CorrespondenceSet set;
  for (const auto& match : matches) set.emplace_back(match.first, match.second);
  const o3d::CorrespondenceCheckerBasedOnEdgeLength edges(0.9);
  const o3d::CorrespondenceCheckerBasedOnDistance distances(max_distance);
  return answer(o3d::RegistrationRANSACBasedOnCorrespondence(
      source.parts().cloud, target.parts().cloud, set, max_distance, o3d::TransformationEstimationPointToPoint(false),
      3, {edges, distances}, o3d::RANSACConvergenceCriteria(max_iterations, 0.999)));
}

PeerPose open3d_gicp(const Open3dCloud& source, const Open3dCloud& target, const PeerTransform& guess,
                     double max_distance, int max_iterations) {
  return answer(o3d::RegistrationGeneralizedICP(source.parts().cloud, target.parts().cloud, max_distance,
                                                guess.matrix(), o3d::TransformationEstimationForGeneralizedICP(),
                                                o3d::ICPConvergenceCriteria(1e-6, 1e-6, max_iterations)));
}

PeerPose open3d_plane_icp(const Open3dCloud& source, const Open3dCloud& target, const PeerTransform& guess,
                          double max_distance, int max_iterations) {
  return answer(o3d::RegistrationICP(source.parts().cloud, target.parts().cloud, max_distance, guess.matrix(),
                                     o3d::TransformationEstimationPointToPlane(),
                                     o3d::ICPConvergenceCriteria(1e-6, 1e-6, max_iterations)));
}

}  // namespace chainslam::bench
