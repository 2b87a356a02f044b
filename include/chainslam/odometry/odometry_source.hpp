#pragma once

#include <concepts>
#include <cstdint>
#include <optional>
#include <type_traits>
#include <utility>

#include "chainslam/core/types.hpp"
#include "chainslam/odometry/deskew.hpp"
#include "chainslam/sensor/frame.hpp"
#include "chainslam/sensor/imu_check.hpp"

namespace chainslam {

/// What became of the input so far.
struct LidarOdometryCounts {
  ScanFilterCounts points{};            ///< points of the scans
  std::int64_t scans = 0;               ///< given
  std::int64_t frames = 0;              ///< answered
  std::int64_t empty_scans = 0;         ///< too few usable points: no frame
  std::int64_t out_of_order_scans = 0;  ///< not later than the frame before, or ending before they begin: no frame
  std::int64_t gaps = 0;                ///< pauses too long to extrapolate the motion
  std::int64_t degenerate_scans = 0;    ///< frames with status degenerate
  std::int64_t lost_scans = 0;          ///< frames with status lost
  std::int64_t map_restarts = 0;        ///< the local map was reset
  std::int64_t gyro_scans = 0;          ///< frames whose rotation was predicted by the gyroscope
  std::int64_t odd_scans = 0;  ///< frames that lie elsewhere than the IMU's motion leads, which was kept: single ones
  ImuCheckCounts imu{};        ///< samples rejected, by kind
};

/// The same of `LidarInertialOdometry`.
struct LidarInertialOdometryCounts : LidarOdometryCounts {
  std::int64_t imu_restarts = 0;         ///< jumps of the IMU's clock back in time
  std::int64_t clipped_imu_samples = 0;  ///< measurements at the end of their range
  std::int64_t unmeasured_scans = 0;     ///< frames to which, for half of the way or more, there were no measurements
  std::int64_t rejected_accelerations = 0;  ///< frames whose scan contradicted the accelerometer, ...
  std::int64_t rejected_rates = 0;          ///< ... and the gyroscope
  std::int64_t evicted_points = 0;          ///< gone from the local map because there were too many
  std::int64_t mounting_resets = 0;  ///< estimates of the extrinsic calibration that went too far and were discarded
};

/// Yields the frames of one session, one after the other.
///
/// Laws: `next()` gives frames with strictly ascending times whose poses are finite, all in one `odom` frame that
/// drifts but never jumps because of anything outside of odometry; after the first `nullopt` it only gives `nullopt`.
template <class T>
concept OdometrySource = requires(T& source) {
  { source.next() } -> std::same_as<std::optional<Frame>>;
};

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
