#pragma once

#include <concepts>
#include <optional>
#include <span>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/slam/chained_closer.hpp"
#include "chainslam/slam/closure_candidates.hpp"
#include "chainslam/slam/keyframe_selector.hpp"
#include "chainslam/slam/odometry_noise.hpp"
#include "chainslam/slam/place_candidates.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam {

/// When a place that was recognized is accepted as the start of tracking.
struct StartOptions {
  /// Times that it was recognized, plus scans that were registered where it and odometry have them, each by itself,
  /// less twice the scans that were not.
  Index min_evidence = 6;
  Index min_recognitions = 2;      ///< of these, by places of the map, or from other scans
  Index min_scans = 3;             ///< registered so,
  double min_travel = 5.0;         ///< and metres along the path between the first and the last of them
  double agree_translation = 0.5;  ///< metres that two of them may differ by,
  double agree_per_metre = 0.02;   ///< and metres for each metre of the path between them
  double agree_rotation = 0.05;    ///< radians
  /// Metres along the path, in either direction, from where a scan was registered to where its registration starts
  /// again. If it ends elsewhere, the scan fits in many places of a street and says nothing about which it is. Less
  /// than an alignment reaches (`AlignmentStarts::spacing`); 0: registrations are not repeated.
  double shift = 2.0;
  double lead = 2.0;    ///< times as much evidence as for any other place of the same frame
  Index max_count = 6;  ///< places that are pursued at a time
};

/// How far a pose in a map can be relied on.
enum class LocalizationStatus {
  searching,  ///< the map does not know the place yet: no pose
  tracking,   ///< registered to the map a short way ago at most
  uncertain,  ///< by odometry alone for some way, or known less well than asked for
  lost,       ///< was tracked and is no longer, and is sought again: no pose
};

/// Where a frame of odometry is in a map.
struct Localization {
  Timestamp time{};                                           ///< of the frame
  LocalizationStatus status = LocalizationStatus::searching;  ///< how far the pose can be relied on
  SessionId frame{};                                          ///< of the map, as `Session::frame`; invalid: no pose
  std::optional<SE3d> T_map_body{};                           ///< pose at `time`, in that frame; none: not known
  Matrix6d covariance = zeros<Matrix6d>();  ///< of T_map_body, tangent [translation; rotation]; zero without a pose
  KeyframeId reference{};                   ///< of the map: the last scan was registered around it; invalid: no pose
  bool registered = false;                  ///< whether this frame's scan was registered to the map
};

/// What a `Localizer` did.
struct LocalizerCounts {
  Index frames = 0;         ///< processed
  Index tracked = 0;        ///< of these with status tracking
  Index uncertain = 0;      ///< with status uncertain
  Index lost = 0;           ///< with status lost
  Index searches = 0;       ///< places sought
  Index starts = 0;         ///< accepted: the first, and one after each time that the pose was lost or wrong
  Index losses = 0;         ///< times that the pose was lost
  Index registrations = 0;  ///< scans registered to the map while tracking, accepted or not
  Index refusals = 0;       ///< of these refused
};

/// Registers a scan to the map around where it has to be: `search`, as the back end has it look for closures, and
/// `align`, to one keyframe's submap; `fits_in_part` says whether one that was refused for its residuals lies where
/// most of it fits.
template <class R>
concept MapRegistration = ClosureAligner<R> &&
    requires(R& closer, std::span<const Keyframe> keyframes, const PositionIndex& index, KeyframeId query,
             const LoopClosure& closure) {
  { closer.search(keyframes, index, query, Serial{}) } -> std::same_as<std::vector<LoopClosure>>;
  { closer.fits_in_part(keyframes, closure) } -> std::same_as<bool>;
};

/// Recognizes places of a map from scans of a drive that is no part of it.
///
/// `remember(keyframes, end, comparable, executor)` takes in the map; `comparable(earlier, later)` says whether two of
/// its keyframes are in one frame. `recognize(keyframes, query)` gives keyframes of the map whose surroundings look
/// like those of the path that ends with `query`, the most similar first; `guess(from, query)` gives T_from_query of
/// one of them.
template <class P>
concept PlaceRecognition = requires(P& places, std::span<const Keyframe> keyframes, KeyframeId id, Index end,
                                    bool (*comparable)(KeyframeId earlier, KeyframeId later)) {
  places.remember(keyframes, end, comparable, Serial{});
  { places.recognize(keyframes, id) } -> std::same_as<std::vector<KeyframeId>>;
  { places.guess(id, id) } -> std::same_as<std::optional<SE3d>>;
};
static_assert(PlaceRecognition<PlaceCandidates>);

/// How a drive is localized in a map.
struct LocalizerOptions {
  /// Which scans are registered to the map; poses between them are odometry's.
  KeyframeOptions scans{.distance = 1.0, .angle = 0.2, .scan_voxel = 0.4, .scan_step = 0};
  double min_period = 0.3;         ///< seconds between two of them, at least: a car moves a metre in each
  StartOptions start{};            ///< when a recognized place is accepted
  OdometryNoise odometry_noise{};  ///< of the poses between
  OdometryNoise unknown_odometry = unknown_odometry_noise();  ///< where frames state no covariance
  OdometryInflation odometry_inflation{};                     ///< where scans between were lost or degenerate
  /// Largest squared Mahalanobis distance between a registered pose and the predicted one: the 99.99 % quantile of
  /// chi-squared with 6 degrees of freedom. What is farther off counts if the next scan agrees with it.
  double gate = 27.9;
  double max_distance = 30.0;    ///< metres along the path without a registration: beyond, the pose is uncertain,
  double max_deviation = 0.5;    ///< as it is beyond this standard deviation of the position, metres, any direction
  double lost_distance = 500.0;  ///< metres along the path without a registration: beyond, the pose is lost,
  double lost_deviation = 5.0;   ///< as it is beyond this standard deviation, metres
};

/// Places as they are sought from a cold start: by the little of the path that was travelled since.
[[nodiscard]] inline PlaceCandidateOptions localizer_places() {
  PlaceCandidateOptions options;
  options.submap_length = 15.0;
  options.spacing = 5.0;
  options.min_share = 0.0;
  options.max_count = 4;
  options.max_drawn = 0;
  options.index.min_inliers = 4;
  return options;
}

}  // namespace chainslam
