#pragma once

#include <string>
#include <variant>
#include <vector>

#include "chainslam/map/frame_record.hpp"
#include "chainslam/map/keyframe.hpp"
#include "chainslam/sensor/gnss_fix.hpp"

namespace chainslam {

/// What follows is of a new session.
struct SessionStart {
  std::string name;  ///< of the session
};

/// One thing that a back end is given. The same inputs in the same order give the same map, bit for bit.
using MapInput = std::variant<SessionStart, Keyframe, GnssFix, std::vector<FrameRecord>>;

}  // namespace chainslam
