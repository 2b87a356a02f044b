#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstddef>
#include <utility>
#include <vector>

namespace chainslam::bench {

/// Points, or unit normals, in the form in which adapters of peers take and give them.
using Positions = std::vector<Eigen::Vector3f>;

/// Pairs of a source and a target index.
using IndexPairs = std::vector<std::pair<int, int>>;

/// A rigid motion whose layout no compiler flag changes: some adapters are compiled with the alignment of the libraries
/// that Debian ships. Converts from and to `Eigen::Isometry3d`.
using PeerTransform = Eigen::Transform<double, 3, Eigen::Isometry, Eigen::DontAlign>;

/// Descriptors, 33 numbers each.
using PeerFeatures = std::vector<std::array<float, 33>>;

/// What a peer's registration answers.
struct PeerPose {
  PeerTransform T_target_source = PeerTransform::Identity();
  int iterations = 0;
  bool converged = false;
  std::size_t inliers = 0;
};

}  // namespace chainslam::bench
