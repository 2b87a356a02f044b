#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <vector>

#include "chainslam/odometry/detail/inertial_motion.hpp"
#include "chainslam/odometry/imu_process.hpp"
#include "chainslam/odometry/lidar_odometry.hpp"
#include "chainslam/slam/keyframe_scan.hpp"
#include "chainslam/slam/keyframe_selector.hpp"
#include "chainslam/slam/localization.hpp"
#include "datasets/dataset.hpp"
#include "presets.hpp"
#include "support/configuration.hpp"
#include "support/imu_clock.hpp"

namespace chainslam::mapper {

/// Bounds that a run has to meet; the program ends with exit code 5 if one is missed. 0 asks for nothing, but of the
/// last two, which hold by default: a map that odometry did not follow is no good map.
struct Goals {
  double max_ape = 0;           ///< metres, of the optimized trajectory against the truth
  double min_odometry_ape = 0;  ///< metres: a drive tests closures only if odometry alone drifts
  double min_ape_ratio = 0;     ///< odometry's error over the optimized one
  Index min_closures = 0;
  Index min_chained_closures = 0;
  double max_inter_session_error = 0;  ///< metres, between keyframes of different sessions at one place
  bool merged = false;                 ///< all sessions in one frame
  double max_lost_share = 0.1;         ///< scans of a session that were not registered, over all; 1 allows any
  Index max_map_restarts = 0;          ///< restarts of a session's local map; -1 allows any
};

/// What turns packets into frames.
enum class OdometrySourceKind {
  lidar,           ///< `LidarOdometry`: scans, the inertial unit's rates where there is one
  lidar_inertial,  ///< `LidarInertialOdometry`: its forces, too
  fast_lio2,       ///< the same as FAST-LIO2 was published
};

/// What is said of the IMU, beside its units and clock, which concern its reader.
struct ImuSettings {
  ImuUse use = ImuUse::all;
  bool calibrate = true;  ///< find its clock's offset and its axes, and correct them; `lidar_inertial` with all of it
  ImuNoise noise{};
  double gyro_range = 0;   ///< rad/s; 0: not known
  double accel_range = 0;  ///< m/s^2; 0: not known
};

/// All that the configuration file can state, with its defaults.
struct MapperOptions {
  datasets::DatasetOptions dataset;
  Preset preset = Preset::best;
  Platform platform = Platform::nclt;
  OdometrySourceKind odometry_source = OdometrySourceKind::lidar_inertial;
  LidarOdometryOptions<> odometry;
  support::FrameClock frame_clock = support::FrameClock::lidar;  ///< `lidar_inertial` with `imu.calibrate`
  bool scan_clock = true;  ///< estimate how far the times of scans are off; `lidar_inertial`
  ImuSettings imu;
  KeyframeOptions keyframes;
  std::size_t scan_memory = ScanCache::default_bytes;  ///< of keyframes' scans that are in their file
  BackEndParts back_end;
  LocalizerOptions localizer;
  PlaceCandidateOptions localizer_places = chainslam::localizer_places();
  double map_voxel = 0.2;  ///< metres, of map.ply
  Goals goals;
};

/// The configuration in force, as a file that repeats the run.
[[nodiscard]] std::string configuration_text(const MapperOptions& options);

/// A source as the settings write it.
[[nodiscard]] const char* name_of(OdometrySourceKind source);

/// Binds the keys of the file to `options`, which must outlive the result.
[[nodiscard]] support::Configuration make_configuration(MapperOptions& options);

/// Reads file (none if empty) and overrides into `options`. @throws support::ConfigError
void configure(MapperOptions& options, const std::filesystem::path& file, const std::vector<std::string>& overrides);

}  // namespace chainslam::mapper
