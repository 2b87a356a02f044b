#include "session_front_end.hpp"

#include <chrono>
#include <cmath>
#include <cstdio>
#include <memory>
#include <optional>
#include <utility>
#include <variant>

#include "chainslam/core/error.hpp"
#include "chainslam/odometry/odometry_source.hpp"
#include "datasets/imu_findings.hpp"
#include "datasets/read_ahead.hpp"
#include "support/summary.hpp"

namespace chainslam::mapper {

SessionFrontEnd::SessionFrontEnd(datasets::Dataset& dataset, const MappingRun& run, const ThreadPool& threads,
                                 FrontEndSink sink)
    : dataset_(dataset), run_(run), threads_(threads), sink_(std::move(sink)) {
  session_.name = dataset.info().name;
  if (waits_for_clock(dataset.info(), run.options))
    imu_clock_.emplace(sink_.retime != nullptr, to_seconds(run.options.dataset.imu_time_offset));
}

SessionRun SessionFrontEnd::run() {
  try {
    if (dataset_.info().has_odometry)
      take_recorded();
    else
      take_packets();
  } catch (const IoError& error) {  // of an input that cannot be read on: what came before is of use all the same
    if (error.kind() != IoError::Kind::input || session_.odometry.empty()) throw;
    session_.failure = error;
  }
  if (imu_clock_) retime(imu_clock_->end());
  note_clock();
  warn_of_lost_scans();
  return std::move(session_);
}

bool SessionFrontEnd::wants_more() {
  session_.memory_full = memory_is_full(run_);
  return !run_.stop.stop_requested() && !session_.memory_full &&
         (run_.max_scans == 0 || session_.scans < run_.max_scans);
}

void SessionFrontEnd::count_scan() {
  ++session_.scans;
  sink_.scan(session_);
}

void SessionFrontEnd::add(const Frame& frame) {
  session_.odometry.times.push_back(frame.time);
  session_.odometry.poses.push_back(frame.T_odom_body);
  count_lost(frame);
  sink_.frame(frame);
}

void SessionFrontEnd::add(Frame frame, const SessionOdometry& odometry) {
  if (imu_clock_) {
    retime(imu_clock_->follow(frame.time, odometry.calibration()));
    frame.time = imu_clock_->frame_time();
  }
  add(frame);
}

void SessionFrontEnd::retime(std::optional<double> shift) {
  if (!shift) return;
  for (Timestamp& time : session_.odometry.times) time = time + seconds(*shift);
  sink_.retime(*shift);
}

void SessionFrontEnd::count_lost(const Frame& frame) {
  if (frame.health.map_restarted) ++lost_.restarts;
  if (frame.health.status != FrameStatus::lost) return;
  const double time = to_seconds(frame.time - session_.odometry.times.front());
  if (lost_.frames++ == 0) lost_.begin = lost_.end = time;
}

void SessionFrontEnd::warn_of_lost_scans() const {
  support::SessionSummary summary{.name = session_.name,
                                  .scans = session_.scans,
                                  .frames = to_index(session_.odometry.size()),
                                  .lost_frames = lost_.frames};
  summary.health.restarts = lost_.restarts;
  if (lost_.frames > 0) summary.health.intervals.push_back(lost_);
  if (const std::string lost = support::health_sentence(summary); !lost.empty()) run_.progress.warning(lost);
}

void SessionFrontEnd::take_recorded() {
  const auto take_fixes = [&] {
    for (const GnssFix& fix : dataset_.take_fixes()) sink_.fix(fix);
  };
  RecordedOdometry odometry([&] {
    const auto measurement = run_.times.measure("read");
    try {
      std::optional<Frame> frame = dataset_.next_frame();
      take_fixes();
      return frame;
    } catch (const IoError&) {  // what came before it counts
      take_fixes();
      throw;
    }
  });
  while (wants_more()) {
    const std::optional<Frame> frame = odometry.next();
    if (!frame) break;
    add(*frame);
    count_scan();
  }
  note(odometry.not_finite(), "frames left out: their poses are not finite");
  note(odometry.too_far(), "frames left out: their poses are more than 1e9 m from the origin");
  note(odometry.out_of_order(), "frames left out: not later than the one before");
}

void SessionFrontEnd::take_packets() {
  const std::unique_ptr<SessionOdometry> odometry = make_session_odometry(run_.options, dataset_.info());
  const auto read = [&] {
    const auto measurement = run_.times.measure("read");
    return dataset_.next();
  };
  datasets::ReadAhead packets(read, run_.max_scans);
  double spent = 0;  // seconds since the last scan
  while (wants_more()) {
    const std::optional<Packet> packet = packets.next();
    if (!packet) break;
    if (const auto* fix = std::get_if<GnssFix>(&*packet)) sink_.fix(*fix);
    if (run_.options.imu.use == ImuUse::none && std::holds_alternative<ImuSample>(*packet)) continue;
    // A filter answers a scan when the measurements up to its end have come: with a packet after it.
    const auto begin = std::chrono::steady_clock::now();
    const std::optional<Frame> frame = odometry->process(*packet, threads_);
    spent += std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    if (std::holds_alternative<LidarScan>(*packet)) {
      run_.times.add("odometry", std::exchange(spent, 0.0));
      count_scan();
    }
    if (frame) add(*frame, *odometry);
  }
  while (const std::optional<Frame> frame = odometry->flush(threads_)) add(*frame, *odometry);
  note_counts(odometry->counts());
  session_.calibration = odometry->calibration();
  if (!session_.calibration) return;
  for (std::string& note : support::calibration_notes(*session_.calibration)) session_.notes.push_back(std::move(note));
}

void SessionFrontEnd::note(std::int64_t count, const std::string& what) {
  if (count > 0) session_.notes.push_back(std::to_string(count) + " " + what);
}

void SessionFrontEnd::note_clock() {
  if (!imu_clock_ || imu_clock_->shift() == 0) return;
  char text[120];
  std::snprintf(text, sizeof text, "poses have the times of the IMU's clock, %.0f ms %s than the scans",
                std::abs(1e3 * imu_clock_->shift()), imu_clock_->shift() > 0 ? "later" : "earlier");
  session_.notes.emplace_back(text);
}

void SessionFrontEnd::note_counts(const LidarOdometryCounts& counts) {
  note(counts.points.not_finite, "points left out: NaN or infinite");
  note(counts.empty_scans, "scans left out: too few usable points");
  note(counts.out_of_order_scans, "scans left out: not later than the one before");
  note(counts.gaps, "gaps in time too long to predict the motion over");
  note(counts.odd_scans, "scans that jumped off the IMU's motion, by wrong times or registration; the motion was kept");
  session_.imu = counts.imu;
  for (std::string& finding : datasets::imu_findings(counts.imu)) session_.notes.push_back(std::move(finding));
}

bool waits_for_clock(const datasets::DatasetInfo& dataset, const MapperOptions& settings) {
  return settings.frame_clock == support::FrameClock::imu && !dataset.has_odometry;
}

KeyframeOptions keyframe_options(const datasets::DatasetInfo& dataset, KeyframeOptions settings) {
  if (!dataset.has_odometry) return settings;
  if (dataset.keyframes && settings != *dataset.keyframes) return settings;
  settings.distance = 0;
  if (dataset.keyframes) settings.scan_voxel = settings.scan_step = 0;
  return settings;
}

Index expected_scans(const datasets::DatasetInfo& dataset, Index max_scans) {
  Index scans = 0;
  for (const datasets::SensorInfo& sensor : dataset.sensors)
    if (sensor.kind == SensorKind::lidar && sensor.count) scans = to_index(*sensor.count);
  return max_scans > 0 && (scans == 0 || max_scans < scans) ? max_scans : scans;
}

}  // namespace chainslam::mapper
