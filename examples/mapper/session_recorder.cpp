#include "session_recorder.hpp"

#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "chainslam/cloud/quantize.hpp"
#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/slam/slam_map.hpp"
#include "session_front_end.hpp"

namespace chainslam::mapper {

namespace {

/// The points that a map keeps of a scan (see `KeyframeSelector`), with their intensities, which a map does not keep.
PointCloud<float> recorded_scan(const PointCloud<float>& scan, const KeyframeOptions& options) {
  const PointCloud<float> kept = options.scan_voxel > 0 ? voxel_downsample(scan, options.scan_voxel) : scan;
  return options.scan_step > 0 ? quantized_with_intensities(kept, options.scan_step) : kept;
}

/// Keyframes as the options pick them, with their whole scans.
KeyframeSelector whole_keyframes(KeyframeOptions options) {
  options.scan_voxel = options.scan_step = 0;
  return KeyframeSelector(options);
}

/// Runs odometry on a data set; frames and what is kept of them go to the recording, all but scans to a map.
class Recorder {
 public:
  Recorder(datasets::Dataset& dataset, const MappingRun& run, datasets::OdometryRecording& recording,
           const ShowProgress& show)
      : dataset_(dataset),
        run_(run),
        recording_(recording),
        show_(show),
        select_(whole_keyframes(run.options.keyframes)),
        waits_(waits_for_clock(dataset.info(), run.options)) {
    state_.stage = "odometry of " + dataset.info().name;
    state_.total = expected_scans(dataset.info(), run.max_scans);
  }

  [[nodiscard]] MappingResult record() {
    const ThreadPool threads(run_.threads);
    MappingResult result;
    result.sessions.push_back(SessionFrontEnd(dataset_, run_, threads,
                                              {.fix = [&](const GnssFix& fix) { recording_.add(fix); },
                                               .frame = [&](const Frame& frame) { add(frame); },
                                               .scan = [&](const SessionRun& so_far) { show(so_far); },
                                               .retime = [&](double shift) { retime(shift); }})
                                  .run());
    run_.progress.finish();
    result.sessions[0].id = session;
    map_.sessions.push_back({.id = session,
                             .name = result.sessions[0].name,
                             .first_keyframe = 0,
                             .keyframes = to_index(map_.keyframes.size()),
                             .frame = session,
                             .prior = {}});
    result.map = std::make_shared<const SlamMap>(std::move(map_));
    result.memory_full = result.sessions[0].memory_full;
    result.interrupted = run_.stop.stop_requested() || result.memory_full;
    return result;
  }

 private:
  static constexpr SessionId session{0};

  void show(const SessionRun& so_far) {
    state_.done = so_far.scans;
    state_.keyframes = to_index(map_.keyframes.size());
    if (show_)
      show_(state_);
    else
      run_.progress.update(state_);
  }

  void add(const Frame& frame) {
    FrameRecord record = record_of(frame);
    record.session = session;
    std::optional<Keyframe> keyframe = select_(frame);
    if (keyframe)
      keyframe->cloud =
          std::make_shared<const PointCloud<float>>(recorded_scan(*keyframe->cloud.load(), run_.options.keyframes));
    if (waits_)
      waiting_.emplace_back(std::move(record), std::move(keyframe));
    else
      write(std::move(record), std::move(keyframe));
  }

  void retime(double shift) {
    waits_ = false;
    for (auto& [record, keyframe] : std::exchange(waiting_, {})) {
      record.time = record.time + seconds(shift);
      if (keyframe) keyframe->time = record.time;
      write(std::move(record), std::move(keyframe));
    }
  }

  void write(FrameRecord record, std::optional<Keyframe> keyframe) {
    {
      const auto measurement = run_.times.measure("write");
      recording_.add(record, keyframe);
    }
    map_.frames.push_back(std::move(record));
    state_.data_seconds = to_seconds(map_.frames.back().time - map_.frames[0].time);
    if (!keyframe) return;
    keyframe->id = KeyframeId{to_index(map_.keyframes.size())};
    keyframe->session = session;
    keyframe->T_map_body = keyframe->T_odom_body;
    keyframe->cloud.reset();  // it is in the recording
    map_.keyframes.push_back(std::move(*keyframe));
  }

  datasets::Dataset& dataset_;
  const MappingRun& run_;
  datasets::OdometryRecording& recording_;
  const ShowProgress& show_;
  KeyframeSelector select_;
  bool waits_;                                                            ///< for the times of frames
  std::vector<std::pair<FrameRecord, std::optional<Keyframe>>> waiting_;  ///< frames until then
  SlamMap map_;
  support::ProgressState state_;
};

}  // namespace

MappingResult record_odometry(datasets::Dataset& dataset, const MappingRun& run, datasets::OdometryRecording& recording,
                              const ShowProgress& show) {
  return Recorder(dataset, run, recording, show).record();
}

datasets::RecordingInfo recording_info(const datasets::DatasetInfo& dataset, const SessionRun& session,
                                       const MapperOptions& options) {
  return {.session = session.name,
          .odometry = name_of(options.odometry_source),
          .source = dataset.source,
          .truth_frame = dataset.truth_frame,
          .scans = session.scans,
          .keyframes = options.keyframes,
          .notes = session.notes};
}

}  // namespace chainslam::mapper
