#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstddef>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/io/ply.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam::bench {

/// Two real clouds and where the source lies.
struct RealPair {
  std::string name;
  PointCloud<float> source;
  PointCloud<float> target;
  SE3d T_target_source;  ///< the truth, or the reference that came with the data
  SE3d guess;            ///< to start from
};

namespace detail {

inline PointCloud<float> read_floats(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  std::vector<Eigen::Vector3f> points(std::filesystem::file_size(path) / sizeof(Eigen::Vector3f));
  file.read(reinterpret_cast<char*>(points.data()), static_cast<std::streamsize>(points.size() * sizeof(points[0])));
  PointCloud<float> cloud;
  cloud.positions = std::move(points);
  return cloud;
}

/// Consecutive scans of an outdoor LiDAR, 69 000 points each, 0.5 m apart (small_gicp's data).
inline RealPair outdoor_pair(const std::filesystem::path& folder) {
  std::ifstream file(folder / "T_target_source.txt");
  Eigen::Matrix4d truth;
  for (Eigen::Index row = 0; row < 4; ++row)
    for (Eigen::Index column = 0; column < 4; ++column) file >> truth(row, column);
  return {"outdoor", read_ply(folder / "source.ply"), read_ply(folder / "target.ply"),
          SE3d(SO3d::from_quaternion(Eigen::Quaterniond(truth.topLeftCorner<3, 3>())), truth.topRightCorner<3, 1>()),
          SE3d()};
}

/// KITTI 00, scans 94 and 95, 122 000 points each, 0.47 m apart; truth by the sequence's poses.
inline RealPair kitti_pair(const std::filesystem::path& folder) {
  Eigen::Matrix3d rotation;
  rotation << 0.999767, 0.021565, 0.000835, -0.021564, 0.999767, -0.001295, -0.000862, 0.001277, 0.999999;
  return {"kitti00", read_kitti_bin(folder / "000095.bin"), read_kitti_bin(folder / "000094.bin"),
          SE3d(SO3d::from_quaternion(Eigen::Quaterniond(rotation)), Eigen::Vector3d(0.474436, -0.015082, 0.009165)),
          SE3d()};
}

/// Four clouds of KITTI 07 joined by their poses, 88 000 points, in the first one's frame, and a fifth, 20 000, started
/// 0.65 m and 2.9 deg beside its pose.
inline RealPair submap_pair(const std::filesystem::path& folder) {
  std::ifstream file(folder / "graph.txt");
  std::vector<SE3d> poses;
  std::string name;
  Eigen::Vector3d t;
  Eigen::Quaterniond q;
  while (poses.size() < 5 && file >> name >> t[0] >> t[1] >> t[2] >> q.x() >> q.y() >> q.z() >> q.w())
    poses.emplace_back(SO3d::from_quaternion(q), t);
  RealPair pair{"submap", {}, {}, poses.at(0).inverse() * poses.at(4), {}};
  for (std::size_t i = 0; i < 4; ++i) {
    const PointCloud<float> part = read_floats(folder / ("00000" + std::to_string(i)) / "points.bin");
    const SE3d T_first_part = poses.at(0).inverse() * poses.at(i);
    for (const Eigen::Vector3f& p : part.positions)
      pair.target.positions.emplace_back((T_first_part * p.cast<double>()).cast<float>());
  }
  pair.source = read_floats(folder / "000004/points.bin");
  Vector6d away;
  away << 0.5, 0.4, 0.1, 0, 0, 0.05;
  pair.guess = pair.T_target_source * SE3d::exp(away);
  return pair;
}

}  // namespace detail

/// The real pairs at hand below CHAINSLAM_UNPACKED_DATA, none without it.
inline const std::vector<RealPair>& real_pairs() {
  static const std::vector<RealPair> pairs = [] {
    std::vector<RealPair> made;
    const char* root = std::getenv("CHAINSLAM_UNPACKED_DATA");
    if (root == nullptr || *root == '\0') return made;
    // An archive's files lie below a folder of its name, or two.
    const auto add = [&](const std::string& folder, const char* file, RealPair (*read)(const std::filesystem::path&)) {
      const auto place = std::filesystem::path(root) / "registration_pairs" / folder;
      for (const auto& path : {place, place / place.filename(), place.parent_path()})
        if (std::filesystem::exists(path / file)) return made.push_back(read(path));
    };
    add("kitti00_094_095", "000094.bin", detail::kitti_pair);
    add("small_gicp_outdoor", "T_target_source.txt", detail::outdoor_pair);
    add("gtsam_points/kitti_07_dump", "graph.txt", detail::submap_pair);
    return made;
  }();
  return pairs;
}

}  // namespace chainslam::bench
