#include "mapping.hpp"

#include <optional>
#include <utility>
#include <variant>

#include "chainslam/odometry/lidar_odometry.hpp"
#include "chainslam/odometry/recorded_odometry.hpp"
#include "chainslam/slam/back_end.hpp"
#include "chainslam/slam/keyframe_selector.hpp"

namespace chainslam::mapper {

namespace {

using Closer = LoopCloser<ProximityCandidates, CoarseToFine<>, HessianCovariance>;

/// The mapper: what odometry says of each scan goes to the trajectory, what the selector picks goes to the back end.
class Mapper {
 public:
  Mapper(const datasets::Dataset& dataset, const MappingRun& run)
      : run_(run),
        select_(keyframe_options(dataset, run.options)),
        back_end_(run.options.back_end,
                  Closer(run.options.closures, run.options.candidates, {}, run.options.closure_covariance),
                  run.options.closure_kernel) {
    back_end_.begin_session(dataset.info().name);
    state_.stage = "mapping";
    for (const datasets::SensorInfo& sensor : dataset.info().sensors)
      if (sensor.kind == SensorKind::lidar && sensor.count) state_.total = to_index(*sensor.count);
    if (run.max_scans > 0 && (state_.total == 0 || run.max_scans < state_.total)) state_.total = run.max_scans;
  }

  /// Whether to go on reading.
  [[nodiscard]] bool wants_more() const {
    return !run_.stop.stop_requested() && (run_.max_scans == 0 || result_.scans < run_.max_scans);
  }

  void count_scan() {
    ++result_.scans;
    state_.done = result_.scans;
    run_.progress.update(state_);
  }

  void add(const GnssFix& fix) { back_end_.add(fix); }

  void add(const Frame& frame) {
    result_.odometry.times.push_back(frame.time);
    result_.odometry.poses.push_back(frame.T_odom_body);
    result_.health.push_back(frame.health);
    state_.data_seconds = to_seconds(frame.time - result_.odometry.times.front());
    if (auto keyframe = select_(frame)) {
      const auto measurement = run_.times.measure("back end");
      back_end_.add(std::move(*keyframe), run_.threads);
    }
    state_.keyframes = to_index(back_end_.map().keyframes.size());
    state_.direct_closures = to_index(back_end_.map().closures.size());
  }

  [[nodiscard]] MappingResult finish() {
    result_.interrupted = run_.stop.stop_requested();
    {
      const auto measurement = run_.times.measure("final optimisation");
      result_.map = back_end_.finish();
    }
    run_.progress.finish();
    if (const BackEndCounts& counts = back_end_.counts(); counts.failed_optimisations > 0)
      note(counts.failed_optimisations, "optimisations failed; the estimates before were kept");
    return std::move(result_);
  }

  void note(std::int64_t count, const std::string& what) {
    if (count > 0) result_.notes.push_back(std::to_string(count) + " " + what);
  }

 private:
  /// Recorded keyframes were selected by whoever recorded them.
  static KeyframeOptions keyframe_options(const datasets::Dataset& dataset, const MapperOptions& options) {
    KeyframeOptions keyframes = options.keyframes;
    if (dataset.info().has_odometry) keyframes.distance = 0;
    return keyframes;
  }

  const MappingRun& run_;
  KeyframeSelector select_;
  BackEnd<Closer, Cauchy> back_end_;
  MappingResult result_;
  support::ProgressState state_;
};

void map_recorded(datasets::Dataset& dataset, const MappingRun& run, Mapper& mapper) {
  const auto next_frame = [&] {
    const auto measurement = run.times.measure("read");
    return dataset.next_frame();
  };
  RecordedOdometry odometry(next_frame);
  while (mapper.wants_more()) {
    const std::optional<Frame> frame = odometry.next();
    if (!frame) break;
    mapper.count_scan();
    mapper.add(*frame);
  }
  mapper.note(odometry.not_finite(), "frames left out: their poses are not finite");
  mapper.note(odometry.out_of_order(), "frames left out: not later than the one before");
}

void note_counts(const LidarOdometryCounts& counts, Mapper& mapper) {
  mapper.note(counts.points.not_finite, "points left out: NaN or infinite");
  mapper.note(counts.empty_scans, "scans left out: too few usable points");
  mapper.note(counts.out_of_order_scans, "scans left out: not later than the one before");
  mapper.note(counts.gaps, "gaps in time too long to predict the motion over");
  mapper.note(counts.lost_scans, "scans lost: nothing in the local map fits them");
  mapper.note(counts.map_restarts, "restarts of the local map after many lost scans");
  mapper.note(counts.dropped_imu_samples, "inertial samples left out: not finite or out of order");
}

void map_packets(datasets::Dataset& dataset, const MappingRun& run, Mapper& mapper) {
  LidarOdometryOptions<> options = run.options.odometry;
  options.T_body_lidar = dataset.info().T_body_lidar;
  LidarOdometry<> odometry(options);
  while (mapper.wants_more()) {
    const std::optional<Packet> packet = [&] {
      const auto measurement = run.times.measure("read");
      return dataset.next();
    }();
    if (!packet) break;
    if (const auto* fix = std::get_if<GnssFix>(&*packet)) mapper.add(*fix);
    if (!std::holds_alternative<LidarScan>(*packet)) {
      odometry.process(*packet, run.threads);
      continue;
    }
    const std::optional<Frame> frame = [&] {
      const auto measurement = run.times.measure("odometry");
      return odometry.process(*packet, run.threads);
    }();
    mapper.count_scan();
    if (frame) mapper.add(*frame);
  }
  note_counts(odometry.counts(), mapper);
}

}  // namespace

MappingResult run_mapping(datasets::Dataset& dataset, const MappingRun& run) {
  Mapper mapper(dataset, run);
  if (dataset.info().has_odometry)
    map_recorded(dataset, run, mapper);
  else
    map_packets(dataset, run, mapper);
  return mapper.finish();
}

}  // namespace chainslam::mapper
