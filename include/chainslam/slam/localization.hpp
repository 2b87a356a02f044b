#pragma once

#include <optional>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam {

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

}  // namespace chainslam
