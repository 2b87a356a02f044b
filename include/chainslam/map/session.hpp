#pragma once

#include <string>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam {

/// One drive: a range of consecutive keyframes.
struct Session {
  SessionId id{};            ///< position among the map's sessions
  std::string name{};        ///< as the user gave it
  Index first_keyframe = 0;  ///< position of its first keyframe
  Index keyframes = 0;       ///< how many keyframes
  /// The session whose start defines the frame that this one's T_map_body are in: itself, until a merge joins it to
  /// an earlier one.
  SessionId frame{};
  /// What the graph knows of the first keyframe beforehand: where T_map_body is, and how well. Zero: nothing.
  SE3d prior{};
  /// Of `prior`, tangent [translation; rotation].
  SqrtInformation<6> prior_sqrt_information = zeros<SqrtInformation<6>>();

  [[nodiscard]] Index end_keyframe() const { return first_keyframe + keyframes; }  ///< behind its last keyframe
};

}  // namespace chainslam
