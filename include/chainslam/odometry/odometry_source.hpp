#pragma once

#include <concepts>
#include <optional>

#include "chainslam/map/frame.hpp"

namespace chainslam {

/// Yields the frames of one session, one after the other.
///
/// Laws: `next()` gives frames with strictly ascending times whose poses are finite, all in one `odom` frame that
/// drifts but never jumps because of anything outside of odometry; after the first `nullopt` it only gives `nullopt`.
template <class T>
concept OdometrySource = requires(T& source) {
  { source.next() } -> std::same_as<std::optional<Frame>>;
};

}  // namespace chainslam
