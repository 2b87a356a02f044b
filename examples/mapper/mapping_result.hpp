#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "chainslam/core/error.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sensor/imu_check.hpp"
#include "chainslam/slam/slam_map.hpp"
#include "chainslam/trajectory/trajectory.hpp"
#include "support/imu_calibration.hpp"

namespace chainslam::mapper {

/// What was found out of one session that this run read, besides what the map keeps of it.
struct SessionRun {
  SessionId id;  ///< in the map
  std::string name;
  Trajectory odometry;                                   ///< T_odom_body of every frame; the map has their health
  Index scans = 0;                                       ///< read
  ImuCheckCounts imu;                                    ///< what became of the IMU's samples
  std::optional<support::ImuCalibration> calibration{};  ///< none if the IMU is taken as given, or there is none
  std::optional<Trajectory> truth;                       ///< T_truth_body; none if nothing states it
  std::optional<IoError> failure{};                      ///< of reading: the session ends before its data do
  bool memory_full = false;                              ///< which ended it; some may be free again
  std::vector<std::string> notes;  ///< what the user should know: scans and points left out, and why
};

/// What the back end did, and how long it took.
struct BackEndFigures {
  Index alignments = 0;  ///< scans registered to submaps, accepted or not
  Index merges = 0;      ///< frames joined
  Index optimizations = 0;
  Index failed_optimizations = 0;        ///< the estimates before were kept
  double closure_radius = 0;             ///< metres, within which closures were sought
  std::vector<double> search_spacing;    ///< metres along the path from one search for closures to the next
  std::vector<double> keyframe_seconds;  ///< of each keyframe added in this run, in order: search, chaining, optimizing
  std::vector<Index> keyframe_alignments;  ///< of the same keyframes: scans registered; empty if not counted
};

/// What a run of the mapper found out.
struct MappingResult {
  std::shared_ptr<const SlamMap> map;  ///< sessions that were loaded first, then those of this run
  std::vector<SessionRun> sessions;    ///< of this run, in the order in which they were read
  std::vector<std::string> notes;      ///< of no session in particular
  bool interrupted = false;            ///< the data were not read to their end
  std::optional<IoError> failure{};    ///< why, if they could not be; the map is that of what came before
  bool memory_full = false;            ///< why, if that was it
  bool truths_share_frame = true;  ///< the sessions' truths are in one frame: errors between sessions mean something
  BackEndFigures figures;
};

}  // namespace chainslam::mapper
