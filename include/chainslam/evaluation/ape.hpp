#pragma once

#include <span>
#include <vector>

#include "chainslam/evaluation/alignment.hpp"
#include "chainslam/evaluation/statistics.hpp"
#include "chainslam/trajectory/association.hpp"

namespace chainslam {

/// Absolute pose errors of all sessions, one after the other; empty and zero unless `status` is `evaluated`.
struct AbsolutePoseErrors {
  EvaluationStatus status = EvaluationStatus::no_poses;  ///< whether there are errors
  Sim3d S_reference_estimate;                            ///< the alignment that was applied
  std::vector<double> translation_errors;                ///< metres
  std::vector<double> rotation_errors;                   ///< radians
  ErrorStatistics translation;                           ///< metres
  ErrorStatistics rotation;                              ///< radians
};

/// Absolute pose errors of sessions that were aligned before: of E = reference^-1 * estimate the length of the
/// translation and the angle of the rotation, as evo defines them (Sturm et al. 2012 for the translation).
[[nodiscard]] inline AbsolutePoseErrors ape(const AlignedSessions& aligned) {
  AbsolutePoseErrors result;
  result.status = aligned.status;
  result.S_reference_estimate = aligned.S_reference_estimate;
  if (aligned.status != EvaluationStatus::evaluated) return result;
  for (const MatchedTrajectories& session : aligned.sessions)
    for (std::size_t i = 0; i < session.reference.size(); ++i) {
      const SE3d error = session.reference.poses[i].inverse() * session.estimate.poses[i];
      result.translation_errors.push_back(error.translation().norm());
      result.rotation_errors.push_back(error.rotation().log().norm());
    }
  result.translation = error_statistics(result.translation_errors).value_or(ErrorStatistics{});
  result.rotation = error_statistics(result.rotation_errors).value_or(ErrorStatistics{});
  return result;
}

/// Aligns several sessions by one transform and takes their absolute pose errors.
/// @throws std::invalid_argument as `align_sessions`.
[[nodiscard]] inline AbsolutePoseErrors ape(std::span<const MatchedTrajectories> sessions,
                                            const AlignmentOptions& options = {}) {
  return ape(align_sessions(sessions, options));
}

/// Absolute pose errors of one trajectory, whose i-th pose belongs to the reference's i-th.
/// @throws std::invalid_argument as `align_sessions`.
[[nodiscard]] inline AbsolutePoseErrors ape(const Trajectory& reference, const Trajectory& estimate,
                                            const AlignmentOptions& options = {}) {
  const MatchedTrajectories session{reference, estimate};
  return ape(std::span(&session, 1), options);
}

}  // namespace chainslam
