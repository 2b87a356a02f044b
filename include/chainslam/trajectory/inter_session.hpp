#pragma once

#include <numbers>
#include <optional>
#include <span>
#include <stdexcept>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/search/kd_tree.hpp"
#include "chainslam/trajectory/alignment.hpp"
#include "chainslam/trajectory/association.hpp"
#include "chainslam/trajectory/pose_errors.hpp"

namespace chainslam {

/// When poses of two sessions count as of one place: where a pair of scans would see much the same.
struct CoLocationOptions {
  double max_distance = 5.0;                ///< metres between the true positions
  double max_angle = std::numbers::pi / 4;  ///< radians between the true rotations
};

/// A pose and its partner in an earlier session.
struct CoLocatedPair {
  Index earlier_session = 0;                                                     ///< position of the earlier session
  Index earlier_pose = 0;                                                        ///< j
  Index later_session = 0;                                                       ///< position of the later session
  Index later_pose = 0;                                                          ///< i
  friend bool operator==(const CoLocatedPair&, const CoLocatedPair&) = default;  ///< whether all members are equal
};

namespace detail {

/// The pose nearest to `pose` among those that face its way, the first of equals; nothing if there is none in reach.
/// @param found  buffer of the search.
[[nodiscard]] inline std::optional<Index> co_located(const Trajectory& among, const KdTree<double>& positions,
                                                     const SE3d& pose, const CoLocationOptions& options,
                                                     std::vector<Neighbor<double>>& found) {
  std::optional<Neighbor<double>> nearest;
  positions.within(pose.translation(), options.max_distance, found);
  for (const Neighbor<double>& neighbor : found) {
    const SO3d& rotation = among.poses[static_cast<std::size_t>(neighbor.index)].rotation();
    const bool nearer = !nearest || neighbor.squared_distance < nearest->squared_distance ||
                        (neighbor.squared_distance == nearest->squared_distance && neighbor.index < nearest->index);
    if (nearer && (rotation.inverse() * pose.rotation()).log().norm() <= options.max_angle) nearest = neighbor;
  }
  if (!nearest) return std::nullopt;
  return nearest->index;
}

}  // namespace detail

/// For each pose the nearest of each earlier session, if the two were at one place: at most one pair for each pose and
/// earlier session, so that a stop does not outweigh a drive. O(n log n) in the poses of two sessions, without stops.
///
/// @param references  true poses of the sessions, all in one frame.
/// @returns pairs in the order of the later session, its pose, and the earlier session.
/// @throws std::invalid_argument if a bound is not positive and finite.
[[nodiscard]] inline std::vector<CoLocatedPair> co_located_pairs(std::span<const Trajectory> references,
                                                                 const CoLocationOptions& options = {}) {
  for (const double bound : {options.max_distance, options.max_angle})
    if (!(bound > 0) || !is_finite(bound))
      throw std::invalid_argument("co_located_pairs: max_distance and max_angle must be positive and finite");
  std::vector<KdTree<double>> trees;
  std::vector<CoLocatedPair> pairs;
  std::vector<Neighbor<double>> found;
  for (std::size_t later = 0; later < references.size(); ++later) {
    const std::vector<SE3d>& poses = references[later].poses;
    for (std::size_t i = 0; i < poses.size(); ++i)
      for (std::size_t earlier = 0; earlier < later; ++earlier)
        if (const auto j = detail::co_located(references[earlier], trees[earlier], poses[i], options, found))
          pairs.push_back({to_index(earlier), *j, to_index(later), to_index(i)});
    std::vector<Eigen::Vector3d> positions;
    for (const SE3d& pose : poses) positions.push_back(pose.translation());
    trees.emplace_back(positions);
  }
  return pairs;
}

/// Relative pose errors between sessions: how well places that several sessions saw are aligned, whatever has
/// drifted elsewhere. Of E = (reference_j^-1 reference_i)^-1 (estimate_j^-1 estimate_i) the length of the translation
/// and the angle of the rotation, as `rpe` (Sturm et al. 2012), but over co-located pairs (j, i) of different sessions.
/// No alignment enters: the estimates must be in one frame, and the references in one of theirs.
///
/// @returns errors in the order of `co_located_pairs`; `no_poses` if there is no pair.
/// @throws std::invalid_argument as `align_sessions` and `co_located_pairs`.
[[nodiscard]] inline RelativePoseErrors inter_session_errors(std::span<const MatchedTrajectories> sessions,
                                                             const CoLocationOptions& options = {}) {
  std::vector<Trajectory> references;
  for (const MatchedTrajectories& session : sessions) {
    detail::check_session(session);
    references.push_back(session.reference);
  }
  RelativePoseErrors result;
  for (const CoLocatedPair& pair : co_located_pairs(references, options)) {
    const auto relative = [&pair, &sessions](Trajectory MatchedTrajectories::*which) {
      const Trajectory& earlier = sessions[static_cast<std::size_t>(pair.earlier_session)].*which;
      const Trajectory& later = sessions[static_cast<std::size_t>(pair.later_session)].*which;
      return earlier.poses[static_cast<std::size_t>(pair.earlier_pose)].inverse() *
             later.poses[static_cast<std::size_t>(pair.later_pose)];
    };
    const SE3d error = relative(&MatchedTrajectories::reference).inverse() * relative(&MatchedTrajectories::estimate);
    result.translation_errors.push_back(error.translation().norm());
    result.rotation_errors.push_back(error.rotation().log().norm());
  }
  if (result.translation_errors.empty()) return result;
  result.status = EvaluationStatus::evaluated;
  result.translation = error_statistics(result.translation_errors).value_or(ErrorStatistics{});
  result.rotation = error_statistics(result.rotation_errors).value_or(ErrorStatistics{});
  return result;
}

}  // namespace chainslam
