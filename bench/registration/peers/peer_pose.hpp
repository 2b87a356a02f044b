#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstddef>
#include <utility>
#include <vector>

namespace chainslam::bench {

/// Points, or unit normals, in the form in which adapters of peers take and give them.
using Positions = std::vector<Eigen::Vector3f>;

/// Pairs of a source and a target index.
using IndexPairs = std::vector<std::pair<int, int>>;

/// What a peer's registration answers.
struct PeerPose {
  Eigen::Isometry3d T_target_source = Eigen::Isometry3d::Identity();
  int iterations = 0;
  bool converged = false;
  std::size_t inliers = 0;
};

}  // namespace chainslam::bench
