#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <span>
#include <stdexcept>
#include <utility>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/trajectory/alignment.hpp"
#include "chainslam/trajectory/association.hpp"
#include "chainslam/trajectory/trajectory.hpp"

namespace chainslam {

/// Lengths of the segments over which KITTI takes relative errors, metres.
inline constexpr std::array<double, 8> kitti_lengths = {100, 200, 300, 400, 500, 600, 700, 800};

/// Which segments are evaluated.
struct KittiOptions {
  /// Poses from the start of a segment to the next start. KITTI's 10 are a second of its 10 Hz; for another rate take
  /// as many poses as come in a second. It decides how densely segments overlap, not what the error of one is.
  Index step = 10;
};

/// The error over one segment of the path, relative to its length.
struct KittiSegment {
  Index session = 0;       ///< position of the session
  Index first = 0;         ///< pose of the session
  Index last = 0;          ///< pose of the session
  double length = 0;       ///< metres; one of `kitti_lengths`
  double translation = 0;  ///< metres per metre
  double rotation = 0;     ///< radians per metre
};

/// Means over the segments of one length.
struct KittiLengthErrors {
  double length = 0;       ///< metres
  Index segments = 0;      ///< the means are 0 without any
  double translation = 0;  ///< metres per metre; times 100: KITTI's percent
  double rotation = 0;     ///< radians per metre
};

/// Relative errors as the KITTI odometry benchmark ranks by them; without segments unless `status` is `evaluated`.
struct KittiErrors {
  EvaluationStatus status = EvaluationStatus::no_poses;  ///< whether there are errors
  std::vector<KittiSegment> segments{};                  ///< session by session, start by start, length by length
  double translation = 0;                                ///< mean over all segments, metres per metre
  double rotation = 0;                                   ///< the same, radians per metre
  std::array<KittiLengthErrors, kitti_lengths.size()> lengths{};  ///< of each of `kitti_lengths`
};

namespace detail {

/// The segments of one session.
inline void append_kitti_segments(const MatchedTrajectories& session, Index number, Index step,
                                  std::vector<KittiSegment>& segments) {
  const std::vector<SE3d>&reference = session.reference.poses, &estimate = session.estimate.poses;
  const std::vector<double> path = path_lengths(reference);
  for (std::size_t i = 0; i < path.size(); i += static_cast<std::size_t>(step))
    for (const double length : kitti_lengths) {
      const auto end = std::upper_bound(path.begin() + static_cast<std::ptrdiff_t>(i), path.end(), path[i] + length);
      if (end == path.end()) break;  // nor is the path long enough for what is longer
      const auto j = static_cast<std::size_t>(end - path.begin());
      const SE3d true_motion = reference[i].inverse() * reference[j];
      const SE3d motion = estimate[i].inverse() * estimate[j];
      const SE3d error = motion.inverse() * true_motion;
      segments.push_back({number, to_index(i), to_index(j), length, error.translation().norm() / length,
                          error.rotation().log().norm() / length});
    }
}

}  // namespace detail

/// The means of segments that were taken before, of one drive or of several.
[[nodiscard]] inline KittiErrors kitti_errors(std::vector<KittiSegment> segments) {
  KittiErrors errors;
  errors.status = segments.empty() ? EvaluationStatus::path_too_short : EvaluationStatus::evaluated;
  errors.segments = std::move(segments);
  for (std::size_t k = 0; k < kitti_lengths.size(); ++k) errors.lengths[k].length = kitti_lengths[k];
  for (const KittiSegment& segment : errors.segments) {
    KittiLengthErrors& of_length =
        *std::find_if(errors.lengths.begin(), errors.lengths.end(),
                      [&](const KittiLengthErrors& each) { return each.length == segment.length; });
    ++of_length.segments;
    of_length.translation += segment.translation;
    of_length.rotation += segment.rotation;
    errors.translation += segment.translation / static_cast<double>(errors.segments.size());
    errors.rotation += segment.rotation / static_cast<double>(errors.segments.size());
  }
  for (KittiLengthErrors& of_length : errors.lengths) {
    of_length.translation /= std::max(1, of_length.segments);
    of_length.rotation /= std::max(1, of_length.segments);
  }
  return errors;
}

/// KITTI's relative errors of sessions that were aligned before (only a scale or a projection changes them).
///
/// Every `step`-th pose i starts a segment of each of `kitti_lengths`. It ends with the first pose j before which more
/// than its length was travelled along the reference; where the path ends sooner there is none. Of the error
/// E = (estimate_i^-1 estimate_j)^-1 (reference_i^-1 reference_j), the length of the translation and the angle of the
/// rotation count, divided by the segment's length. Means are taken over all segments of all sessions alike, so that
/// short ones, of which there are more, weigh more. Geiger, Lenz and Urtasun 2012, *Are we ready for autonomous
/// driving?*; the odometry benchmark's development kit decides what the paper leaves open.
///
/// Estimate and reference must be poses of one sensor: a lever arm between them counts as error wherever the path
/// turns.
///
/// @returns status `path_too_short` if no path is longer than 100 m.
/// @throws std::invalid_argument if the step is not positive.
[[nodiscard]] inline KittiErrors kitti_errors(const AlignedSessions& aligned, const KittiOptions& options = {}) {
  if (options.step < 1) throw std::invalid_argument("kitti_errors: the step must be at least one pose");
  if (aligned.status != EvaluationStatus::evaluated) return {.status = aligned.status};
  std::vector<KittiSegment> segments;
  for (std::size_t i = 0; i < aligned.sessions.size(); ++i)
    detail::append_kitti_segments(aligned.sessions[i], to_index(i), options.step, segments);
  return kitti_errors(std::move(segments));
}

/// KITTI's relative errors of one trajectory, unaligned, whose i-th pose belongs to the reference's i-th.
/// @throws std::invalid_argument as `align_sessions`, or if the step is not positive.
[[nodiscard]] inline KittiErrors kitti_errors(const Trajectory& reference, const Trajectory& estimate,
                                              const KittiOptions& options = {}) {
  const MatchedTrajectories session{reference, estimate};
  return kitti_errors(align_sessions(std::span(&session, 1), {.align = Alignment::none}), options);
}

}  // namespace chainslam
