#pragma once

#include <map>
#include <span>
#include <vector>

#include "chainslam/slam/slam_map.hpp"
#include "chainslam/trajectory/inter_session.hpp"
#include "chainslam/trajectory/pose_errors.hpp"

namespace chainslam::experiments {

/// Errors of a map's keyframes against their true poses: what the tables have of a run, NaN where there is nothing.
struct GraphErrors {
  ErrorStatistics ape, ape_rotation, ape_2d, between, between_rotation;  ///< metres, radians
  Index frames = 0, pairs = 0;
};

/// @param truth  T_truth_body by keyframe.
inline GraphErrors graph_errors(const SlamMap& map, std::span<const SE3d> truth) {
  std::map<SessionId, std::vector<MatchedTrajectories>> by_frame;
  for (const Session& session : map.sessions) {
    MatchedTrajectories& matched = by_frame[session.frame].emplace_back();
    for (Index i = session.first_keyframe; i < session.end_keyframe(); ++i) {
      matched.reference.poses.push_back(truth[static_cast<std::size_t>(i)]);
      matched.estimate.poses.push_back(map.keyframes[static_cast<std::size_t>(i)].T_map_body);
    }
  }
  std::vector<double> translation, rotation, flat, between, between_rotation;
  const auto append = [](std::vector<double>& all, const std::vector<double>& more) {
    all.insert(all.end(), more.begin(), more.end());
  };
  for (const auto& [frame, sessions] : by_frame) {
    const AbsolutePoseErrors in_space = ape(align_sessions(sessions));
    append(translation, in_space.translation_errors);
    append(rotation, in_space.rotation_errors);
    append(flat, ape(align_sessions(sessions, {.project_xy = true})).translation_errors);
    const RelativePoseErrors pairs = inter_session_errors(sessions);
    append(between, pairs.translation_errors);
    append(between_rotation, pairs.rotation_errors);
  }
  const auto statistics = [](const std::vector<double>& errors) {
    return error_statistics(errors).value_or(ErrorStatistics{});
  };
  return {.ape = statistics(translation),
          .ape_rotation = statistics(rotation),
          .ape_2d = statistics(flat),
          .between = statistics(between),
          .between_rotation = statistics(between_rotation),
          .frames = to_index(by_frame.size()),
          .pairs = to_index(between.size())};
}

}  // namespace chainslam::experiments
