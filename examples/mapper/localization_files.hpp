#pragma once

#include <optional>
#include <span>

#include "chainslam/io/atomic_file.hpp"
#include "chainslam/slam/localization.hpp"
#include "chainslam/slam/slam_map.hpp"
#include "chainslam/trajectory/pose_errors.hpp"
#include "support/statistics.hpp"

namespace chainslam::mapper {

/// What a run of `chainslam localize` found out.
struct LocalizationRun {
  std::vector<Localization> frames{};
  LocalizerCounts counts{};
  std::optional<double> first_fix{};           ///< seconds from the first frame to the first pose
  std::optional<AbsolutePoseErrors> errors{};  ///< of poses that were tracked, against the truth
  bool interrupted = false;
  std::vector<support::StageTime> stages{};
  double data_seconds = 0, wall_seconds = 0;
};

/// How a status is written.
[[nodiscard]] const char* status_name(LocalizationStatus status);

/// A row for each frame: time, status, frame of the map, reference keyframe, pose and covariance, which are empty
/// without a pose.
void write_localizations(const FileTarget& target, std::span<const Localization> frames);

/// The poses that there are.
[[nodiscard]] Trajectory localized_poses(std::span<const Localization> frames, bool tracked_only);

/// Counts and figures, as JSON.
void write_localization_summary(const FileTarget& target, const LocalizationRun& run);

}  // namespace chainslam::mapper
