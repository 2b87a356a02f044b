#include "support/frame_health.hpp"

#include <algorithm>
#include <array>
#include <cstdio>
#include <optional>

namespace chainslam::support {
namespace {

constexpr std::array concerns{FrameConcern::lost,          FrameConcern::gap,       FrameConcern::degenerate,
                              FrameConcern::accelerometer, FrameConcern::gyroscope, FrameConcern::imu};

bool concerns_frame(FrameConcern concern, const FrameHealth& health) {
  switch (concern) {
    case FrameConcern::lost:
      return health.status == FrameStatus::lost || health.map_restarted;
    case FrameConcern::gap:
      return health.after_gap;
    case FrameConcern::degenerate:
      return health.status == FrameStatus::degenerate;
    case FrameConcern::accelerometer:
      return health.imu_use == ImuUse::gyroscope && !health.imu_as_set;
    case FrameConcern::gyroscope:
      return health.imu_use == ImuUse::rough_gyroscope;
    case FrameConcern::imu:
      return health.imu_use == ImuUse::none;
  }
  return false;
}

void add_intervals(std::span<const FrameRecord> frames, FrameConcern concern, std::vector<FrameInterval>& intervals) {
  constexpr double pause = 1.0;  // seconds
  bool open = false;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    if (!concerns_frame(concern, frames[i].health)) continue;
    const double time = to_seconds(frames[i].time - frames.front().time);
    if (!open || time - intervals.back().end >= pause)
      intervals.push_back({.concern = concern, .begin = time, .first = to_index(i)});
    open = true;
    FrameInterval& interval = intervals.back();
    interval.end = time;
    interval.last = to_index(i);
    ++interval.frames;
    if (frames[i].health.map_restarted) ++interval.restarts;
  }
}

/// Whether most frames of a second or more are concerned, where the concern is the IMU; all else counts at once.
bool lasts(const FrameInterval& interval) {
  if (interval.concern < FrameConcern::accelerometer) return true;
  constexpr double least = 1.0 - 1e-6;  // seconds, as times have few digits
  return interval.end - interval.begin >= least && 2 * interval.frames > interval.last - interval.first + 1;
}

double distance(std::span<const FrameRecord> frames, const FrameInterval& interval) {
  double sum = 0;
  for (auto i = static_cast<std::size_t>(std::max<Index>(interval.first, 1));
       i <= static_cast<std::size_t>(interval.last); ++i)
    sum += (frames[i].T_odom_body.translation() - frames[i - 1].T_odom_body.translation()).norm();
  return sum;
}

void count_use(const std::optional<ImuUse>& use, ImuUseCounts& counts) {
  if (!use) return;
  ++(*use == ImuUse::all ? counts.all : *use == ImuUse::gyroscope ? counts.gyroscope : counts.scans_only);
}

}  // namespace

std::string text_of(const ImuUseCounts& counts) {
  if (counts.frames() == 0) return "";
  const auto percent = [&](Index count) { return 100 * counts.share(count); };
  char text[160];
  std::snprintf(text, sizeof text,
                "%.1f %% of frames with all of the IMU, %.1f %% with its gyroscope, %.1f %% by scans alone",
                percent(counts.all), percent(counts.gyroscope), percent(counts.scans_only));
  return text;
}

std::string name_of(FrameConcern concern) {
  switch (concern) {
    case FrameConcern::lost:
      return "scans lost";
    case FrameConcern::gap:
      return "gap between scans";
    case FrameConcern::degenerate:
      return "directions not observed";
    case FrameConcern::accelerometer:
      return "accelerometer contradicted by the scans";
    case FrameConcern::gyroscope:
      return "gyroscope contradicted by the scans";
    case FrameConcern::imu:
      return "IMU not used";
  }
  return "unknown";
}

SessionHealth health_of(std::span<const FrameRecord> frames) {
  SessionHealth health{.frames = to_index(frames.size())};
  for (const FrameRecord& frame : frames) {
    if (frame.health.status == FrameStatus::lost) ++health.lost;
    if (frame.health.status == FrameStatus::degenerate) ++health.degenerate;
    if (frame.health.map_restarted) ++health.restarts;
  }
  for (const FrameRecord& frame : frames) count_use(frame.health.imu_use, health.imu_use);
  for (const FrameConcern concern : concerns) add_intervals(frames, concern, health.intervals);
  std::erase_if(health.intervals, [](const FrameInterval& interval) { return !lasts(interval); });
  for (FrameInterval& interval : health.intervals) interval.distance = distance(frames, interval);
  std::ranges::stable_sort(health.intervals, {}, &FrameInterval::begin);
  return health;
}

Trajectory odometry_of(std::span<const FrameRecord> frames) {
  Trajectory odometry;
  odometry.times.reserve(frames.size());
  odometry.poses.reserve(frames.size());
  for (const FrameRecord& frame : frames) {
    odometry.times.push_back(frame.time);
    odometry.poses.push_back(frame.T_odom_body);
  }
  return odometry;
}

}  // namespace chainslam::support
