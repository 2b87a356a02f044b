#pragma once

#include <optional>
#include <type_traits>
#include <utility>

#include "chainslam/core/finite.hpp"
#include "chainslam/odometry/odometry_source.hpp"

namespace chainslam {

/// Yields frames that were recorded, odometry and all: keyframe data sets, files of an earlier run, simulations.
///
/// @tparam NextFrame  a callable that returns `std::optional<Frame>`, nothing when there is no more.
///
/// What the recording holds is passed on but for three things, each counted: a frame whose pose is not finite, one that
/// is farther from the origin than anything on Earth from any of its frames, and one that is not later than the frame
/// before.
template <class NextFrame>
class RecordedOdometry {
  static_assert(std::is_invocable_r_v<std::optional<Frame>, NextFrame&>,
                "RecordedOdometry: NextFrame needs `std::optional<Frame> operator()()`");

 public:
  static constexpr double farthest = 1e9;  ///< metres from the origin

  /// @param next_frame  returns an optional frame; nothing at the end.
  explicit RecordedOdometry(NextFrame next_frame) : next_frame_(std::move(next_frame)) {}

  /// The next usable frame.
  [[nodiscard]] std::optional<Frame> next() {
    while (!ended_) {
      std::optional<Frame> frame = next_frame_();
      if (!frame) {
        ended_ = true;
      } else if (!is_finite(frame->T_odom_body.matrix())) {
        ++not_finite_;
      } else if (!(frame->T_odom_body.translation().norm() <= farthest)) {
        ++too_far_;
      } else if (last_ && frame->time <= *last_) {
        ++out_of_order_;
      } else {
        last_ = frame->time;
        return frame;
      }
    }
    return std::nullopt;
  }

  [[nodiscard]] Index not_finite() const { return not_finite_; }      ///< frames dropped for their pose
  [[nodiscard]] Index too_far() const { return too_far_; }            ///< frames dropped for their distance
  [[nodiscard]] Index out_of_order() const { return out_of_order_; }  ///< frames dropped for their time

 private:
  NextFrame next_frame_;
  std::optional<Timestamp> last_;
  bool ended_ = false;
  Index not_finite_ = 0;
  Index too_far_ = 0;
  Index out_of_order_ = 0;
};

}  // namespace chainslam
