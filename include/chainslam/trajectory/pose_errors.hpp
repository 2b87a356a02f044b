#pragma once

#include <algorithm>
#include <cmath>
#include <optional>
#include <span>
#include <stdexcept>
#include <utility>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/trajectory/alignment.hpp"
#include "chainslam/trajectory/association.hpp"

namespace chainslam {

/// What evo states of a list of errors, in the errors' unit (`sse` in its square).
struct ErrorStatistics {
  Index count = 0;    ///< how many errors
  double rmse = 0;    ///< root of the mean square
  double mean = 0;    ///< arithmetic mean
  double median = 0;  ///< mean of the two middle ones of an even number
  double std = 0;     ///< of the population, as numpy's default
  double min = 0;     ///< smallest
  double max = 0;     ///< largest
  double sse = 0;     ///< sum of squares
};

/// Statistics of errors that are finite; nothing if there are none.
[[nodiscard]] inline std::optional<ErrorStatistics> error_statistics(std::span<const double> errors) {
  if (errors.empty()) return std::nullopt;
  ErrorStatistics result;
  result.count = to_index(errors.size(), "errors");
  const double count = static_cast<double>(errors.size());
  for (const double error : errors) {
    result.mean += error / count;
    result.sse += error * error;
  }
  double variance = 0;
  for (const double error : errors) variance += (error - result.mean) * (error - result.mean) / count;
  result.std = std::sqrt(variance);
  result.rmse = std::sqrt(result.sse / count);

  std::vector<double> sorted(errors.begin(), errors.end());
  std::sort(sorted.begin(), sorted.end());
  result.min = sorted.front();
  result.max = sorted.back();
  const std::size_t middle = sorted.size() / 2;
  result.median = sorted.size() % 2 == 1 ? sorted[middle] : 0.5 * (sorted[middle - 1] + sorted[middle]);
  return result;
}

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

enum class DeltaUnit { metres, frames };
enum class PairChoice {
  consecutive,  ///< the next pair begins where the last one ended
  all           ///< one pair from each pose that has a partner
};

/// Over which pairs relative errors are taken.
struct RpeOptions {
  double delta = 1.0;                          ///< metres along the estimated path, or a whole number of frames
  DeltaUnit unit = DeltaUnit::frames;          ///< of `delta`
  PairChoice pairs = PairChoice::consecutive;  ///< how pairs follow one another
  double tolerance = 0.1;                      ///< of delta, by which all pairs in metres may miss it; evo's default
};

/// Relative pose errors of all sessions, one after the other; empty and zero if there is no pair.
struct RelativePoseErrors {
  EvaluationStatus status = EvaluationStatus::no_poses;  ///< whether there are errors
  std::vector<double> translation_errors;                ///< metres
  std::vector<double> rotation_errors;                   ///< radians
  ErrorStatistics translation;                           ///< metres
  ErrorStatistics rotation;                              ///< radians
};

using PosePair = std::pair<Index, Index>;

namespace detail {

/// Ends of stretches of at least `delta` metres; the path before the first end belongs to no pair, as in evo.
inline std::vector<PosePair> consecutive_pairs_by_path(std::span<const SE3d> poses, double delta) {
  std::vector<PosePair> pairs;
  Index begin = -1;
  double length = 0;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    if (i > 0) length += (poses[i].translation() - poses[i - 1].translation()).norm();
    if (length < delta) continue;
    const Index end = to_index(i, "poses");
    if (begin >= 0) pairs.emplace_back(begin, end);
    begin = end;
    length = 0;
  }
  return pairs;
}

/// From each pose to the later one whose way along the path is nearest to `delta`, if within `tolerance` of it; the
/// first of equals. O(n log n).
inline std::vector<PosePair> all_pairs_by_path(std::span<const SE3d> poses, double delta, double tolerance) {
  std::vector<PosePair> pairs;
  const std::vector<double> lengths = path_lengths(poses);
  for (std::size_t i = 0; i + 1 < lengths.size(); ++i) {
    const auto way = [&](std::size_t j) { return lengths[j] - lengths[i]; };
    const auto next = lengths.begin() + static_cast<std::ptrdiff_t>(i + 1);
    auto j = static_cast<std::size_t>(std::lower_bound(next, lengths.end(), lengths[i] + delta) - lengths.begin());
    if (j == lengths.size() || (j > i + 1 && delta - way(j - 1) <= way(j) - delta)) --j;
    j = static_cast<std::size_t>(std::lower_bound(next, lengths.end(), lengths[j]) - lengths.begin());
    if (std::abs(way(j) - delta) <= tolerance) pairs.emplace_back(to_index(i), to_index(j));
  }
  return pairs;
}

inline std::vector<PosePair> pairs_by_frames(Index poses, Index delta, PairChoice choice) {
  std::vector<PosePair> pairs;
  const Index step = choice == PairChoice::consecutive ? delta : 1;
  for (Index i = 0; poses - i > delta; i += step) pairs.emplace_back(i, i + delta);
  return pairs;
}

}  // namespace detail

/// The pairs of poses that `options` ask for, chosen as evo does: along the estimate's own path.
/// @throws std::invalid_argument if delta is not positive, or not whole for frames.
[[nodiscard]] inline std::vector<PosePair> rpe_pairs(std::span<const SE3d> estimate, const RpeOptions& options) {
  if (!(options.delta > 0) || !is_finite(options.delta))
    throw std::invalid_argument("rpe: delta must be positive and finite");
  if (options.unit == DeltaUnit::metres)
    return options.pairs == PairChoice::consecutive
               ? detail::consecutive_pairs_by_path(estimate, options.delta)
               : detail::all_pairs_by_path(estimate, options.delta, options.delta * options.tolerance);
  if (options.delta != std::floor(options.delta)) throw std::invalid_argument("rpe: a delta in frames must be whole");
  const Index poses = to_index(estimate.size(), "poses");
  if (options.delta >= poses) return {};
  return detail::pairs_by_frames(poses, static_cast<Index>(options.delta), options.pairs);
}

/// Relative pose errors of sessions that were aligned before (only a scale or a projection changes them): of
/// E = (reference_i^-1 reference_j)^-1 (estimate_i^-1 estimate_j) the length of the translation and the angle of the
/// rotation, over pairs (i, j) within a session. As evo; Sturm et al. 2012.
/// @throws std::invalid_argument as `rpe_pairs`.
[[nodiscard]] inline RelativePoseErrors rpe(const AlignedSessions& aligned, const RpeOptions& options = {}) {
  RelativePoseErrors result;
  result.status = aligned.status;
  if (aligned.status != EvaluationStatus::evaluated) return result;
  for (const auto& [reference, estimate] : aligned.sessions)
    for (const PosePair& pair : rpe_pairs(estimate.poses, options)) {
      const auto i = static_cast<std::size_t>(pair.first), j = static_cast<std::size_t>(pair.second);
      const SE3d true_step = reference.poses[i].inverse() * reference.poses[j];
      const SE3d step = estimate.poses[i].inverse() * estimate.poses[j];
      const SE3d error = true_step.inverse() * step;
      result.translation_errors.push_back(error.translation().norm());
      result.rotation_errors.push_back(error.rotation().log().norm());
    }
  result.translation = error_statistics(result.translation_errors).value_or(ErrorStatistics{});
  result.rotation = error_statistics(result.rotation_errors).value_or(ErrorStatistics{});
  return result;
}

/// Relative pose errors of one trajectory, unaligned, whose i-th pose belongs to the reference's i-th.
/// @throws std::invalid_argument as `align_sessions` and `rpe_pairs`.
[[nodiscard]] inline RelativePoseErrors rpe(const Trajectory& reference, const Trajectory& estimate,
                                            const RpeOptions& options = {}) {
  const MatchedTrajectories session{reference, estimate};
  return rpe(align_sessions(std::span(&session, 1), {.align = Alignment::none}), options);
}

}  // namespace chainslam
