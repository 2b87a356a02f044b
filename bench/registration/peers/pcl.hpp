#pragma once

#include <memory>
#include <vector>

#include "registration/peers/peer_pose.hpp"

namespace chainslam::bench {

/// A cloud in PCL's own form, and what PCL has made of it. One thread throughout.
class PclCloud {
 public:
  /// @param normals  none, or one a point.
  explicit PclCloud(const Positions& points, const Positions& normals = {});
  PclCloud(PclCloud&&) noexcept;
  PclCloud& operator=(PclCloud&&) noexcept;
  ~PclCloud();

  [[nodiscard]] std::size_t size() const;
  [[nodiscard]] Positions positions() const;
  [[nodiscard]] Positions normals() const;
  [[nodiscard]] std::vector<float> curvatures() const;
  [[nodiscard]] PeerFeatures features() const;

  /// `pcl::VoxelGrid`: means of cubes.
  [[nodiscard]] PclCloud downsampled(double voxel) const;
  /// `pcl::NormalEstimationOMP` from the `neighbors` nearest, or from all within `radius` if `neighbors` is 0, turned
  /// towards the viewpoint.
  void estimate_normals(int neighbors, double radius, const Eigen::Vector3f& viewpoint = Eigen::Vector3f::Zero());
  /// `pcl::FPFHEstimationOMP` over the normals there are.
  void estimate_fpfh(double radius);

  struct Parts;
  [[nodiscard]] const Parts& parts() const { return *parts_; }

 private:
  explicit PclCloud(std::unique_ptr<Parts> parts);
  std::unique_ptr<Parts> parts_;
};

struct PclSettings {
  double max_distance = 1.0;  ///< metres
  int max_iterations = 50;
  double transformation_epsilon = 1e-6;
};

/// `pcl::GeneralizedIterativeClosestPoint`, its trees and covariances included: it makes them anew in each call.
[[nodiscard]] PeerPose pcl_gicp(const PclCloud& source, const PclCloud& target, const PeerTransform& guess,
                                const PclSettings& settings = {});

/// `pcl::IterativeClosestPointWithNormals`, its tree included; both clouds have normals.
[[nodiscard]] PeerPose pcl_icp_with_normals(const PclCloud& source, const PclCloud& target, const PeerTransform& guess,
                                            const PclSettings& settings = {});

/// `pcl::SampleConsensusPrerejective` over features, three points a sample, two candidates a feature.
[[nodiscard]] PeerPose pcl_prerejective(const PclCloud& source, const PclCloud& target, double max_distance,
                                        int iterations = 5000);

}  // namespace chainslam::bench
