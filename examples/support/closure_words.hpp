#pragma once

#include <string>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam::support {

/// What is told of a closure, in words and figures.
struct ClosureAccount {
  Index number = -1;  ///< among the map's closures; -1: refused, and only on record
  const LoopClosure* closure = nullptr;
  SessionId from{}, to{};  ///< sessions of its keyframes
  std::string tried;       ///< why: "near by the estimate", "closures connect it with closure 12", ...
  std::string outcome;     ///< what became of it: "accepted", "refused: too few inliers (12 %)", ...
};

/// All closures of a map in their order, then all that were refused. The map must outlive the result.
[[nodiscard]] std::vector<ClosureAccount> closure_accounts(const SlamMap& map);

}  // namespace chainslam::support
