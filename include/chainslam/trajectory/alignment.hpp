#pragma once

#include <cmath>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/lie/sim3.hpp"
#include "chainslam/lie/umeyama.hpp"
#include "chainslam/trajectory/association.hpp"
#include "chainslam/trajectory/trajectory.hpp"

namespace chainslam {

/// How an estimate is brought into the reference's frame before errors are taken.
enum class Alignment {
  none,
  origin,  ///< so that the first poses agree
  se3,     ///< rotation and translation that fit all positions best (Umeyama 1991)
  sim3     ///< with the scale that fits best
};

/// How an estimate is aligned to its reference.
struct AlignmentOptions {
  Alignment align = Alignment::se3;  ///< which transforms are allowed
  /// Poses are first laid flat: z is dropped and only the rotation about z is kept, as evo's `--project_to_plane xy`.
  bool project_xy = false;
};

/// Why there are no errors, where there are none.
enum class EvaluationStatus {
  evaluated,
  no_poses,              ///< nothing was matched
  degenerate_alignment,  ///< too few positions, or all on one line: no rotation fits best
  path_too_short         ///< shorter than the shortest segment over which errors are taken
};

/// Sessions in the reference's frame, all under one alignment.
struct AlignedSessions {
  EvaluationStatus status = EvaluationStatus::no_poses;  ///< whether they could be aligned
  Sim3d S_reference_estimate;                            ///< p_reference = S p_estimate
  std::vector<MatchedTrajectories> sessions;             ///< projected and aligned
};

/// The pose laid flat: z is 0, and of the rotation R = Rz(yaw) Ry(pitch) Rx(roll) only the yaw is kept.
[[nodiscard]] inline SE3d projected_to_xy(const SE3d& pose) {
  const Eigen::Vector3d forward = pose.rotation() * Eigen::Vector3d::UnitX();
  const double yaw = std::atan2(forward.y(), forward.x());
  return SE3d(SO3d::exp({0, 0, yaw}), {pose.translation().x(), pose.translation().y(), 0});
}

namespace detail {

inline void check_session(const MatchedTrajectories& session) {
  if (session.reference.size() != session.estimate.size())
    throw std::invalid_argument("evaluation: " + std::to_string(session.reference.size()) + " reference poses and " +
                                std::to_string(session.estimate.size()) + " estimated ones; associate them first");
  const auto check = [](const Trajectory& trajectory, const char* name) {
    if (const auto at = first_not_finite(trajectory.poses))
      throw std::invalid_argument("evaluation: pose " + std::to_string(*at) + " of the " + name + " is not finite");
  };
  check(session.reference, "reference");
  check(session.estimate, "estimate");
}

inline std::vector<Eigen::Vector3d> positions(std::span<const MatchedTrajectories> sessions,
                                              Trajectory MatchedTrajectories::*which) {
  std::vector<Eigen::Vector3d> result;
  for (const auto& session : sessions)
    for (const SE3d& pose : (session.*which).poses) result.push_back(pose.translation());
  return result;
}

}  // namespace detail

/// Brings the estimates of several sessions, whose references share one frame, into that frame by one alignment.
///
/// @throws std::invalid_argument if a session's trajectories differ in length or hold numbers that are not finite.
[[nodiscard]] inline AlignedSessions align_sessions(std::span<const MatchedTrajectories> sessions,
                                                    const AlignmentOptions& options = {}) {
  AlignedSessions result;
  for (const MatchedTrajectories& session : sessions) {
    detail::check_session(session);
    if (!session.estimate.empty()) result.sessions.push_back(session);
  }
  if (result.sessions.empty()) return result;
  if (options.project_xy)
    for (MatchedTrajectories& session : result.sessions)
      for (Trajectory* trajectory : {&session.reference, &session.estimate})
        for (SE3d& pose : trajectory->poses) pose = projected_to_xy(pose);

  const MatchedTrajectories& first = result.sessions.front();
  if (options.align == Alignment::origin) {
    const SE3d T_reference_estimate = first.reference.poses.front() * first.estimate.poses.front().inverse();
    result.S_reference_estimate = Sim3d(T_reference_estimate.rotation(), T_reference_estimate.translation(), 1.0);
  } else if (options.align != Alignment::none) {
    const auto fit =
        umeyama(detail::positions(result.sessions, &MatchedTrajectories::estimate),
                detail::positions(result.sessions, &MatchedTrajectories::reference), options.align == Alignment::sim3);
    if (!fit) {
      result.status = EvaluationStatus::degenerate_alignment;
      return result;
    }
    result.S_reference_estimate = *fit;
  }
  const Sim3d& S = result.S_reference_estimate;
  for (MatchedTrajectories& session : result.sessions)
    for (SE3d& pose : session.estimate.poses) pose = SE3d(S.rotation() * pose.rotation(), S * pose.translation());
  result.status = EvaluationStatus::evaluated;
  return result;
}

}  // namespace chainslam
