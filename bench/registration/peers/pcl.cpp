#include "registration/peers/pcl.hpp"

#include <pcl/features/fpfh_omp.h>
#include <pcl/features/normal_3d_omp.h>
#include <pcl/filters/voxel_grid.h>
#include <pcl/point_types.h>
#include <pcl/registration/gicp.h>
#include <pcl/registration/icp.h>
#include <pcl/registration/sample_consensus_prerejective.h>
#include <pcl/search/kdtree.h>

#include <algorithm>

namespace chainslam::bench {

struct PclCloud::Parts {
  pcl::PointCloud<pcl::PointXYZ>::Ptr points = std::make_shared<pcl::PointCloud<pcl::PointXYZ>>();
  pcl::PointCloud<pcl::Normal>::Ptr normals = std::make_shared<pcl::PointCloud<pcl::Normal>>();
  pcl::PointCloud<pcl::PointNormal>::Ptr oriented = std::make_shared<pcl::PointCloud<pcl::PointNormal>>();
  pcl::PointCloud<pcl::FPFHSignature33>::Ptr features = std::make_shared<pcl::PointCloud<pcl::FPFHSignature33>>();

  /// Points and normals in one cloud, as registration wants them.
  void join() {
    oriented->resize(normals->size());
    for (std::size_t i = 0; i < normals->size(); ++i) {
      (*oriented)[i].getVector3fMap() = (*points)[i].getVector3fMap();
      (*oriented)[i].getNormalVector3fMap() = (*normals)[i].getNormalVector3fMap();
      (*oriented)[i].curvature = (*normals)[i].curvature;
    }
  }
};

PclCloud::PclCloud(std::unique_ptr<Parts> parts) : parts_(std::move(parts)) {}
PclCloud::PclCloud(PclCloud&&) noexcept = default;
PclCloud& PclCloud::operator=(PclCloud&&) noexcept = default;
PclCloud::~PclCloud() = default;

PclCloud::PclCloud(const Positions& points, const Positions& normals) : parts_(new Parts) {
  for (const Eigen::Vector3f& p : points) parts_->points->emplace_back(p.x(), p.y(), p.z());
  for (const Eigen::Vector3f& n : normals) parts_->normals->emplace_back(n.x(), n.y(), n.z());
  parts_->join();
}

std::size_t PclCloud::size() const { return parts_->points->size(); }

Positions PclCloud::positions() const {
  Positions result;
  for (const pcl::PointXYZ& p : *parts_->points) result.emplace_back(p.x, p.y, p.z);
  return result;
}

Positions PclCloud::normals() const {
  Positions result;
  for (const pcl::Normal& n : *parts_->normals) result.emplace_back(n.normal_x, n.normal_y, n.normal_z);
  return result;
}

std::vector<float> PclCloud::curvatures() const {
  std::vector<float> result;
  for (const pcl::Normal& n : *parts_->normals) result.push_back(n.curvature);
  return result;
}

PeerFeatures PclCloud::features() const {
  PeerFeatures result;
  for (const pcl::FPFHSignature33& signature : *parts_->features)
    std::copy_n(signature.histogram, 33, result.emplace_back().begin());
  return result;
}

PclCloud PclCloud::downsampled(double voxel) const {
  const auto edge = static_cast<float>(voxel);
  pcl::VoxelGrid<pcl::PointXYZ> grid;
  grid.setLeafSize(edge, edge, edge);
  grid.setInputCloud(parts_->points);
  auto parts = std::make_unique<Parts>();
  grid.filter(*parts->points);
  return PclCloud(std::move(parts));
}

void PclCloud::estimate_normals(int neighbors, double radius, const Eigen::Vector3f& viewpoint) {
  pcl::NormalEstimationOMP<pcl::PointXYZ, pcl::Normal> estimation(1);
  estimation.setInputCloud(parts_->points);
  estimation.setSearchMethod(std::make_shared<pcl::search::KdTree<pcl::PointXYZ>>());
  estimation.setViewPoint(viewpoint.x(), viewpoint.y(), viewpoint.z());
  if (neighbors > 0) {
    estimation.setKSearch(neighbors);
  } else {
    estimation.setRadiusSearch(radius);
  }
  estimation.compute(*parts_->normals);
  parts_->join();
}

void PclCloud::estimate_fpfh(double radius) {
  pcl::FPFHEstimationOMP<pcl::PointXYZ, pcl::Normal, pcl::FPFHSignature33> estimation(1);
  estimation.setInputCloud(parts_->points);
  estimation.setInputNormals(parts_->normals);
  estimation.setSearchMethod(std::make_shared<pcl::search::KdTree<pcl::PointXYZ>>());
  estimation.setRadiusSearch(radius);
  estimation.compute(*parts_->features);
}

namespace {

template <class Registration>
PeerPose answer(Registration& registration) {
  PeerPose result;
  result.T_target_source.matrix() = registration.getFinalTransformation().template cast<double>();
  result.converged = registration.hasConverged();
  return result;
}

template <class Registration, class Points>
PeerPose align(Registration& registration, const Points& source, const Points& target, const PeerTransform& guess,
               const PclSettings& settings) {
  registration.setInputSource(source);
  registration.setInputTarget(target);
  registration.setMaxCorrespondenceDistance(settings.max_distance);
  registration.setMaximumIterations(settings.max_iterations);
  registration.setTransformationEpsilon(settings.transformation_epsilon);
  typename Points::element_type aligned;
  registration.align(aligned, guess.matrix().cast<float>());
  return answer(registration);
}

}  // namespace

PeerPose pcl_gicp(const PclCloud& source, const PclCloud& target, const PeerTransform& guess,
                  const PclSettings& settings) {
  pcl::GeneralizedIterativeClosestPoint<pcl::PointXYZ, pcl::PointXYZ> registration;
  return align(registration, source.parts().points, target.parts().points, guess, settings);
}

PeerPose pcl_icp_with_normals(const PclCloud& source, const PclCloud& target, const PeerTransform& guess,
                              const PclSettings& settings) {
  pcl::IterativeClosestPointWithNormals<pcl::PointNormal, pcl::PointNormal> registration;
  return align(registration, source.parts().oriented, target.parts().oriented, guess, settings);
}

PeerPose pcl_prerejective(const PclCloud& source, const PclCloud& target, double max_distance, int iterations) {
  pcl::SampleConsensusPrerejective<pcl::PointXYZ, pcl::PointXYZ, pcl::FPFHSignature33> registration;
  registration.setInputSource(source.parts().points);
  registration.setSourceFeatures(source.parts().features);
  registration.setInputTarget(target.parts().points);
  registration.setTargetFeatures(target.parts().features);
  registration.setMaximumIterations(iterations);
  registration.setNumberOfSamples(3);
  registration.setCorrespondenceRandomness(2);
  registration.setSimilarityThreshold(0.9f);
  registration.setMaxCorrespondenceDistance(max_distance);
  registration.setInlierFraction(0.05f);
  pcl::PointCloud<pcl::PointXYZ> aligned;
  registration.align(aligned);
  PeerPose result = answer(registration);
  result.inliers = registration.getInliers().size();
  return result;
}

}  // namespace chainslam::bench
