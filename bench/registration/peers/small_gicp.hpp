#pragma once

#include <memory>
#include <numbers>

#include "registration/peers/peer_pose.hpp"

namespace chainslam::bench {

/// A cloud in small_gicp's own form (Koide 2024), and what has been made of it. One thread throughout.
class SmallGicpCloud {
 public:
  explicit SmallGicpCloud(const Positions& points);
  SmallGicpCloud(SmallGicpCloud&&) noexcept;
  SmallGicpCloud& operator=(SmallGicpCloud&&) noexcept;
  ~SmallGicpCloud();

  [[nodiscard]] std::size_t size() const;
  [[nodiscard]] Positions positions() const;
  [[nodiscard]] Positions normals() const;
  [[nodiscard]] std::vector<Eigen::Matrix3d> covariances() const;

  /// Its voxel grid: means of cubes.
  [[nodiscard]] SmallGicpCloud downsampled(double voxel) const;
  /// Its k-d tree, over which normals, 1-NN queries and registration go.
  void build_tree();
  /// Normals and covariances in one pass over the tree.
  void estimate_normals_and_covariances(int neighbors);
  /// The Gaussian voxels that VGICP aligns to; covariances come first.
  void build_voxel_map(double resolution);
  /// The sum over this cloud's points of the squared distance to the nearest in `target`, which has a tree.
  [[nodiscard]] double sum_of_squared_distances_to(const SmallGicpCloud& target) const;

  struct Parts;
  [[nodiscard]] const Parts& parts() const { return *parts_; }

 private:
  explicit SmallGicpCloud(std::unique_ptr<Parts> parts);
  std::unique_ptr<Parts> parts_;
};

enum class SmallGicpMetric { point, plane, gicp, vgicp };

/// Its own defaults, but for the distance.
struct SmallGicpSettings {
  double max_distance = 1.0;  ///< metres
  int max_iterations = 20;
  double translation_eps = 1e-3;                         ///< metres
  double rotation_eps = 0.1 * std::numbers::pi / 180.0;  ///< radians
  bool gauss_newton = false;                             ///< else Levenberg and Marquardt, its default
};

/// Its alignment alone. The target has a tree and, as the metric asks, normals, covariances or a voxel map; the source
/// has covariances for gicp and vgicp.
[[nodiscard]] PeerPose small_gicp_align(SmallGicpMetric metric, const SmallGicpCloud& source,
                                        const SmallGicpCloud& target, const PeerTransform& guess,
                                        const SmallGicpSettings& settings = {});

/// What small_gicp makes of a cloud before it aligns it by GICP: thinned, tree, normals and covariances of 10 points.
[[nodiscard]] SmallGicpCloud small_gicp_prepared(const Positions& points, double voxel, int neighbors = 10);

/// A scan against a prepared submap, all that a scan costs included: the copy into its form, its voxel grid, tree and
/// covariances, and GICP.
[[nodiscard]] PeerPose small_gicp_scan_to_submap(const Positions& scan, double voxel, const SmallGicpCloud& submap,
                                                 const PeerTransform& guess, const SmallGicpSettings& settings = {});

}  // namespace chainslam::bench
