#pragma once

#include <string>

#include "chainslam/core/types.hpp"

namespace chainslam {

/// One drive: a range of consecutive keyframes.
struct Session {
  SessionId id;
  std::string name;
  Index first_keyframe = 0;
  Index keyframes = 0;
};

}  // namespace chainslam
