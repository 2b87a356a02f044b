#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "chainslam/io/atomic_file.hpp"
#include "chainslam/sensor/frame.hpp"
#include "chainslam/sensor/packet.hpp"
#include "chainslam/slam/keyframe_selector.hpp"
#include "chainslam/slam/slam_map.hpp"
#include "chainslam/trajectory/trajectory.hpp"
#include "datasets/dataset.hpp"

// A recording of odometry: a keyframe set that other programs can read as well, and beside it what mapping needs to
// give the same map as the data themselves.
//   Scans/%06d.pcd, times.txt, odom_poses.txt   of the keyframes, as in any keyframe set
//                  (x y z of the points that the map keeps, and their intensity if the data have it)
//   frames.csv     every frame: time, keyframe or -1, health, T_odom_body, covariance (upper triangle as floats), what
//                  the accelerometer measured since the frame before (dv_x, dv_y, dv_z: integral of the specific force,
//                  m/s, body frame at the frame's time; empty if not measured, no columns in earlier recordings)
//   fixes.csv      GNSS fixes, each with the number of frames before it
//   truth.tum      T_map_body, if it is known
//   odometry.json  format, version, name of the session, how keyframes were picked, notes
// Numbers are written as short as they read back the same: nothing is rounded.

namespace chainslam::datasets {

inline constexpr const char* recording_description = "odometry.json";
inline constexpr const char* recording_format = "chainslam odometry";
inline constexpr int recording_version = 1;

/// What a recording states beside its tables.
struct RecordingInfo {
  std::string session{};      ///< name
  std::string odometry{};     ///< what made it: "lidar", "lidar_inertial" or "fast_lio2"
  std::string source{};       ///< how the data came about, where they are not recorded throughout
  std::string truth_frame{};  ///< as in `DatasetInfo`
  std::int64_t scans = 0;     ///< given to odometry
  std::int64_t frames = 0;    ///< answered by it
  std::int64_t lost_frames = 0;
  KeyframeOptions keyframes{};
  std::vector<std::string> notes{};
};

/// Writes a recording frame by frame.
class OdometryRecording {
 public:
  /// @param folder  an empty folder. @throws IoError
  explicit OdometryRecording(std::filesystem::path folder);

  /// The next frame of odometry, and what the map would keep of it. @throws IoError
  void add(const FrameRecord& frame, const std::optional<Keyframe>& keyframe);
  void add(const GnssFix& fix);

  /// Completes the tables; counts the frames of `info` itself. @throws IoError
  void finish(RecordingInfo info, const std::optional<Trajectory>& truth);

 private:
  std::filesystem::path folder_;
  AtomicFile frames_, fixes_;
  Trajectory keyframes_;  ///< T_odom_body
  std::int64_t frame_count_ = 0, lost_ = 0, fix_count_ = 0;
};

/// Whether a folder holds a recording, by the names in it.
[[nodiscard]] bool is_recorded_odometry(const std::filesystem::path& folder);

/// Opens a recording; the frames that are no keyframes have no scan. Scans are the map's, bit for bit: intensities are
/// given if `options.recorded_intensities` asks for them. @throws IoError naming file, line and field.
[[nodiscard]] std::unique_ptr<Dataset> open_recorded_odometry(const std::filesystem::path& folder,
                                                              const DatasetOptions& options);

}  // namespace chainslam::datasets
