#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <fstream>
#include <numbers>
#include <vector>

#include "chainslam/io/trajectory_file.hpp"
#include "chainslam/lie/umeyama.hpp"
#include "chainslam/slam/slam_map.hpp"
#include "program/run_program.hpp"

#include <doctest/doctest.h>

namespace chainslam::test {

/// In how many frames the sessions of a map lie.
inline std::size_t frame_count(const SlamMap& map) {
  return static_cast<std::size_t>(
      std::ranges::count_if(map.sessions, [](const Session& session) { return session.frame == session.id; }));
}

inline SE3d read_matrix(const fs::path& path) {
  std::ifstream file(path);
  Eigen::Matrix4d matrix;
  for (Eigen::Index row = 0; row < 4; ++row)
    for (Eigen::Index column = 0; column < 4; ++column) file >> matrix(row, column);
  REQUIRE(static_cast<bool>(file));
  return SE3d::from_matrix(matrix);
}

/// Fits a session's keyframes to the reference's poses of it, positions and attitudes: what is fitted are the corners
/// of a tripod of 10 m at each pose. @returns T_map_reference.
inline SE3d fitted(const SlamMap& map, std::size_t session, const std::vector<SE3d>& reference) {
  std::vector<Eigen::Vector3d> source, target;
  for (Index i = 0; i < map.sessions[session].keyframes; ++i)
    for (const Eigen::Vector3d& corner :
         {Eigen::Vector3d(0, 0, 0), Eigen::Vector3d(10, 0, 0), Eigen::Vector3d(0, 10, 0), Eigen::Vector3d(0, 0, 10)}) {
      source.push_back(reference[static_cast<std::size_t>(i)] * corner);
      target.push_back(map.keyframes[static_cast<std::size_t>(map.sessions[session].first_keyframe + i)].T_map_body *
                       corner);
    }
  const Sim3d fit = umeyama(source, target, false).value();
  return SE3d(fit.rotation(), fit.translation());
}

inline double in_degrees(const SE3d& T) { return T.rotation().log().norm() * 180 / std::numbers::pi; }

}  // namespace chainslam::test
