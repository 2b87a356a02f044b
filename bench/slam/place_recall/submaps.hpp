#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstddef>
#include <limits>
#include <optional>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/features/height_image.hpp"
#include "chainslam/slam/slam_map.hpp"
#include "chainslam/trajectory/trajectory.hpp"

namespace chainslam::bench {

/// The scans along a piece of path in one level frame, by odometry, and where that frame truly lies.
struct Submap {
  SE3d T_truth_submap;
  PointCloud<float> cloud;  ///< positions alone
};

/// How a session is cut into submaps.
struct SubmapCut {
  double length = 60;   ///< metres along the path
  double spacing = 15;  ///< metres from the start of one to the start of the next
  double heading = 0;   ///< radians by which the submaps' frames are turned: nothing may hang on odometry's own
};

/// Submaps of a session, the middle keyframe of each at its origin. Those without a true pose there are left out.
/// @param truth  T_truth_body, by time
inline std::vector<Submap> submaps_of(const std::vector<Keyframe>& keyframes, const Trajectory& truth,
                                      const SubmapCut& cut) {
  std::vector<SE3d> poses;
  for (const Keyframe& keyframe : keyframes) poses.push_back(keyframe.T_odom_body);
  const std::vector<double> way = path_lengths(poses);
  std::vector<Submap> submaps;
  for (double begin = 0; !way.empty() && begin + cut.length <= way.back() + 0.5 * cut.spacing; begin += cut.spacing) {
    std::vector<std::size_t> members;
    std::size_t center = 0;
    double least = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < way.size(); ++i) {
      if (way[i] < begin || way[i] > begin + cut.length) continue;
      members.push_back(i);
      if (const double off = std::abs(way[i] - begin - 0.5 * cut.length); off < least) least = off, center = i;
    }
    if (members.empty()) continue;
    const std::optional<SE3d> T_truth_body = pose_at(truth, keyframes[center].time, seconds(1));
    if (!T_truth_body) continue;
    const SE3d T_submap_odom =
        SE3d(SO3d::exp({0, 0, cut.heading}), Eigen::Vector3d::Zero()) * SE3d(SO3d(), -poses[center].translation());
    Submap submap{.T_truth_submap = *T_truth_body * poses[center].inverse() * T_submap_odom.inverse(), .cloud = {}};
    for (const std::size_t i : members) {
      const auto cloud = keyframes[i].cloud.load();
      if (!cloud) continue;
      const PointCloud<float> seen = transformed(cloud->positions, T_submap_odom * poses[i]);
      submap.cloud.positions.insert(submap.cloud.positions.end(), seen.positions.begin(), seen.positions.end());
    }
    submaps.push_back(std::move(submap));
  }
  return submaps;
}

}  // namespace chainslam::bench
