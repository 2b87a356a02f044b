#pragma once

#include <cstddef>
#include <ctime>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/sensor/frame.hpp"
#include "chainslam/slam/slam_map.hpp"
#include "graph/sampled_drives.hpp"

namespace chainslam::experiments {

/// What drawn odometry states of its frames: little enough that the noise of a step is that of its length, but not
/// nothing, which would count as odometry of unknown quality. What a recording states, and where it lost scans, goes
/// with the errors that it made there; drawn errors are those of other places.
inline PackedCovariance hardly_any_covariance() { return PackedCovariance(scaled(1e-30, identity<Matrix6d>())); }

/// The recorded frames of leg `i` with what their accelerometer measured, on drawn odometry: the true motion since the
/// keyframe before, and of the drawn error the frame's share of the step's time.
inline std::vector<FrameRecord> drawn_frames(const MeasuredDrive& drive, const DrawnOdometry& drawn, std::size_t i) {
  const std::size_t before = i == 0 ? 0 : i - 1;
  const SE3d T_odom_truth = drawn.odometry.poses[before] * drive.truth.poses[before].inverse();
  const double duration = to_seconds(drive.truth.times[i] - drive.truth.times[before]);
  std::vector<FrameRecord> frames;
  for (const MeasuredFrame& one : drive.legs[i].frames) {
    FrameRecord& frame = frames.emplace_back();
    frame.time = one.time;
    frame.T_odom_body = T_odom_truth * one.T_truth_body;
    if (i > 0)
      frame.T_odom_body *=
          SE3d::exp(to_seconds(one.time - drive.truth.times[before]) / duration * drawn.errors[before]);
    frame.covariance = hardly_any_covariance();
    frame.delta_velocity = one.delta_velocity;
  }
  return frames;
}

/// Processor time of the calling thread, milliseconds.
inline double thread_milliseconds() {
  timespec time{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return 1e3 * static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_nsec);
}

/// Gives a back end a drive with drawn odometry as a session: its frames, keyframes and fixes, in the mapper's order.
/// @param drive  with a leg for each keyframe.
/// @returns milliseconds of processor time for each keyframe, with what came before it.
template <class BackEnd>
std::vector<double> map_session(BackEnd& back_end, const MeasuredDrive& drive, const DrawnOdometry& drawn,
                                std::string name) {
  back_end.begin_session(std::move(name));
  std::vector<double> milliseconds;
  for (std::size_t i = 0; i < drive.truth.size(); ++i) {
    Keyframe keyframe;
    keyframe.time = drawn.odometry.times[i];
    keyframe.T_odom_body = drawn.odometry.poses[i];
    const std::vector<FrameRecord> frames = drawn_frames(drive, drawn, i);
    const double start = thread_milliseconds();
    for (const GnssFix& fix : drive.legs[i].fixes) back_end.add(fix);
    back_end.add(std::span<const FrameRecord>(frames));
    back_end.add(std::move(keyframe));
    milliseconds.push_back(thread_milliseconds() - start);
  }
  for (const GnssFix& fix : drive.last_fixes) back_end.add(fix);
  return milliseconds;
}

}  // namespace chainslam::experiments
