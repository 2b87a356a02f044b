#pragma once

#include <filesystem>
#include <fstream>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "chainslam/io/pcd.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "chainslam/slam/place_candidates.hpp"
#include "chainslam/slam/slam_map.hpp"
#include "support/real_data.hpp"
#include "support/real_matrix.hpp"

namespace chainslam::test {

/// Two sessions in a map, each in a frame of its own, with the true motion from the second one's odometry to the
/// first's.
struct TwoSessions {
  SlamMap map;
  SE3d T_first_second;

  void add_session() {
    const SessionId id{to_index(map.sessions.size())};
    map.sessions.push_back({id, {}, to_index(map.keyframes.size()), 0, id, {}, {}});
  }
  void add(Keyframe keyframe) {
    keyframe.id = KeyframeId{to_index(map.keyframes.size())};
    keyframe.session = map.sessions.back().id;
    ++map.sessions.back().keyframes;
    map.keyframes.push_back(std::move(keyframe));
  }
  [[nodiscard]] std::vector<KeyframeId> queries(double every) const {
    std::vector<KeyframeId> ids;
    double travelled = 0;
    for (Index i = map.sessions[1].first_keyframe + 1; i < to_index(map.keyframes.size()); ++i) {
      const auto pose = [&](Index k) { return map.keyframes[static_cast<std::size_t>(k)].T_odom_body.translation(); };
      travelled += (pose(i) - pose(i - 1)).norm();
      if (travelled < every) continue;
      travelled = 0;
      ids.push_back(KeyframeId{i});
    }
    return ids;
  }
  [[nodiscard]] SE3d truth(KeyframeId from, KeyframeId to) const {
    const auto pose = [&](KeyframeId id) { return map.keyframes[static_cast<std::size_t>(id.value)].T_odom_body; };
    return pose(from).inverse() * T_first_second * pose(to);
  }
};

/// The courtyard that was walked twice. The second walk's odometry starts `heading` turned about the vertical.
inline std::optional<TwoSessions> two_walks(double heading) {
  const auto root = real_data("hku_square_two_sessions");
  if (!root) return std::nullopt;
  TwoSessions sessions;
  const SE3d turn(SO3d::exp({0, 0, heading}), Eigen::Vector3d::Zero());
  sessions.T_first_second = read_matrix(*root / "T_session1_session2.txt") * turn.inverse();
  for (const std::string name : {"session1", "session2"}) {
    const std::filesystem::path folder = *root / name;
    const std::vector<SE3d> poses = read_kitti_poses(folder / "odom_poses.txt").poses;
    std::ifstream times(folder / "times.txt");
    sessions.add_session();
    for (std::size_t i = 0; i < poses.size(); ++i) {
      const std::string number = std::to_string(i);
      Keyframe keyframe;
      double time = 0;
      times >> time;
      keyframe.time = Timestamp::from_seconds(time);
      keyframe.T_odom_body = keyframe.T_map_body = name == "session1" ? poses[i] : turn * poses[i];
      keyframe.cloud = std::make_shared<const PointCloud<float>>(
          read_pcd(folder / "Scans" / (std::string(6 - number.size(), '0') + number + ".pcd")));
      sessions.add(std::move(keyframe));
    }
  }
  return sessions;
}

/// For submaps of 10 m in a courtyard: finer than outdoors.
inline PlaceCandidateOptions for_courtyard() {
  PlaceCandidateOptions options;
  options.submap_length = 10;
  options.spacing = 2;
  options.max_count = 1;
  options.max_drawn = 0;  // queries are not made at each keyframe
  options.image = {.cell_size = 0.25, .max_range = 50};
  options.index.consensus.max_distance = 0.75;
  return options;
}

}  // namespace chainslam::test
