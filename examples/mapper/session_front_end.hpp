#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/sensor/frame.hpp"
#include "chainslam/sensor/packet.hpp"
#include "chainslam/slam/keyframe_selector.hpp"
#include "datasets/dataset.hpp"
#include "mapping.hpp"
#include "mapping_result.hpp"
#include "session_odometry.hpp"
#include "support/frame_health.hpp"
#include "support/imu_clock.hpp"

namespace chainslam::mapper {

/// Where a front end's results go, in the order in which they come.
struct FrontEndSink {
  std::function<void(const GnssFix&)> fix;
  std::function<void(const Frame&)> frame;
  std::function<void(const SessionRun&)> scan;  ///< after each scan that was read, with what the session is so far
  /// If frames are kept until their clock is known: that all so far are later than stated, by these seconds. Once,
  /// where `waits_for_clock`.
  std::function<void(double)> retime{};
};

/// Reads one data set, and runs odometry on it or takes what was recorded.
class SessionFrontEnd {
 public:
  /// @param run  must outlive the object, as must the data set and the threads.
  SessionFrontEnd(datasets::Dataset& dataset, const MappingRun& run, const ThreadPool& threads, FrontEndSink sink);

  /// To the end of the data, or until the run is to stop. Scans that were lost are told as a warning; data that cannot
  /// be read to their end are the session's `failure`. @throws IoError if they cannot be read at all.
  [[nodiscard]] SessionRun run();

 private:
  [[nodiscard]] bool wants_more();
  void count_scan();
  void add(const Frame& frame);
  void add(Frame frame, const SessionOdometry& odometry);  ///< with its time on the clock that was asked for
  void retime(std::optional<double> shift);
  void count_lost(const Frame& frame);
  void take_recorded();
  void take_packets();
  void note(std::int64_t count, const std::string& what);
  void note_clock();
  void note_counts(const LidarOdometryCounts& counts);
  void warn_of_lost_scans() const;

  datasets::Dataset& dataset_;
  const MappingRun& run_;
  const ThreadPool& threads_;
  FrontEndSink sink_;
  std::optional<support::ImuClock> imu_clock_;  ///< none: frames keep the scans' times
  SessionRun session_;
  support::FrameInterval lost_;  ///< all scans that were, from the first on
};

/// Whether the times of a session's first frames come later than the frames.
[[nodiscard]] bool waits_for_clock(const datasets::DatasetInfo& dataset, const MapperOptions& settings);

/// How keyframes are picked of a data set's frames: by the settings; of recorded odometry, all that were recorded, as
/// they were kept, unless the settings ask for others than the recording has.
[[nodiscard]] KeyframeOptions keyframe_options(const datasets::DatasetInfo& dataset, KeyframeOptions settings);

/// How many scans of a data set a run will read; 0 if that is not known.
[[nodiscard]] Index expected_scans(const datasets::DatasetInfo& dataset, Index max_scans);

}  // namespace chainslam::mapper
