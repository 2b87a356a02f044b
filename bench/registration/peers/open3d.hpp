#pragma once

#include <memory>

#include "registration/peers/peer_pose.hpp"

namespace chainslam::bench {

/// A cloud in Open3D's own form, and what Open3D has made of it. One thread throughout.
class Open3dCloud {
 public:
  /// @param normals  none, or one a point.
  explicit Open3dCloud(const Positions& points, const Positions& normals = {});
  Open3dCloud(Open3dCloud&&) noexcept;
  Open3dCloud& operator=(Open3dCloud&&) noexcept;
  ~Open3dCloud();

  [[nodiscard]] std::size_t size() const;
  [[nodiscard]] Positions positions() const;
  [[nodiscard]] Positions normals() const;
  [[nodiscard]] PeerFeatures features() const;

  /// `VoxelDownSample`: means of cubes, counted from the cloud's lowest corner.
  [[nodiscard]] Open3dCloud downsampled(double voxel) const;
  /// `EstimateNormals` from at most `neighbors` within `radius`, turned towards the viewpoint.
  void estimate_normals(int neighbors, double radius, const Eigen::Vector3f& viewpoint = Eigen::Vector3f::Zero());
  /// `ComputeFPFHFeature` from at most `neighbors` within `radius`, over the normals there are.
  void estimate_fpfh(double radius, int neighbors = 100);

  struct Parts;
  [[nodiscard]] const Parts& parts() const { return *parts_; }

 private:
  explicit Open3dCloud(std::unique_ptr<Parts> parts);
  std::unique_ptr<Parts> parts_;
};

/// Mutual matches of the features, by the calls that its feature registration makes: a `KDTreeFlann` each way.
[[nodiscard]] IndexPairs open3d_matches(const Open3dCloud& source, const Open3dCloud& target);

/// `RegistrationRANSACBasedOnCorrespondence`: three points, edge lengths (0.9) and distance checked, confidence 0.999.
[[nodiscard]] PeerPose open3d_ransac(const Open3dCloud& source, const Open3dCloud& target, const IndexPairs& matches,
                                     double max_distance, int max_iterations = 100000, unsigned seed = 0);

/// `RegistrationGeneralizedICP`, its tree and covariances included.
[[nodiscard]] PeerPose open3d_gicp(const Open3dCloud& source, const Open3dCloud& target, const PeerTransform& guess,
                                   double max_distance, int max_iterations = 50);

/// `RegistrationICP`, point to plane, its tree included; the target has normals.
[[nodiscard]] PeerPose open3d_plane_icp(const Open3dCloud& source, const Open3dCloud& target,
                                        const PeerTransform& guess, double max_distance, int max_iterations = 50);

}  // namespace chainslam::bench
