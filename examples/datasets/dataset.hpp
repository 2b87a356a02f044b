#pragma once

#include <cstddef>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "chainslam/core/timestamp.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/sensor/frame.hpp"
#include "chainslam/sensor/packet.hpp"
#include "chainslam/slam/keyframe_selector.hpp"
#include "chainslam/trajectory/trajectory.hpp"
#include "datasets/point_time.hpp"

namespace chainslam::datasets {

/// The layouts that `open_dataset` knows.
enum class DatasetKind {
  nclt,
  range_images,
  keyframes,
  kitti,
  kitti_raw,
  mulran,
  helipr,
  newer_college,
  nuscenes,
  ros,
  clouds
};

/// Short name of a kind, as options and messages write it.
[[nodiscard]] std::string_view name_of(DatasetKind kind);

/// What the axes of an NCLT folder's scans mean.
enum class NcltAxes {
  automatic,  ///< NCLT's, unless the ground says otherwise and a calib.txt says that the scans were converted
  nclt,       ///< x forward, y right, z down: turned to x forward, y left, z up
  kitti       ///< x forward, y left, z up: taken as they are
};

/// Which record of positions an NCLT folder gives.
enum class NcltGnss { automatic, rtk, consumer, none };

/// Which units an IMU's numbers have: m/s^2 or g, rad/s or deg/s.
enum class ImuUnitsGiven { automatic, si, g, degrees, g_and_degrees };

/// What a warning about times of points that could not be read says at its end.
inline constexpr const char* point_time_settings =
    "; set dataset.point_time_unit, point_time_base or point_time_direction to use them";

struct DatasetOptions {
  std::optional<DatasetKind> kind{};   ///< found by looking at the folder if absent
  std::optional<SE3d> T_body_lidar{};  ///< extrinsic calibration that overrides the data set's own
  std::filesystem::path truth{};       ///< a TUM file with T_map_body, if the data set's own is to be overridden
  NcltAxes axes = NcltAxes::automatic;
  NcltGnss gnss = NcltGnss::automatic;  ///< automatic: RTK if it is there
  bool prefer_sync = false;             ///< NCLT: velodyne_sync although there is a velodyne_hits.bin
  double scan_rate = 10;                ///< Hz, of folders of clouds whose times nothing states
  PointTimeHints point_time{};          ///< what is known of the time field of points in PCD, PLY and ROS messages
  bool times_from_azimuth = true;       ///< of nuScenes' and MARS's points, which have none
  bool recorded_intensities = false;    ///< of recorded odometry: scans with intensities, which maps leave out
  double kitti_elevation_offset_deg =
      0.205;                  ///< KITTI odometry: points are turned up by this, 0 leaves them as they are
  std::string lidar_topic{};  ///< of ROS recordings; the one with most points at the start if empty; HeLiPR's
  std::string imu_topic{};    ///< the same, with most messages
  std::string gnss_topic{};
  ImuUnitsGiven imu_units = ImuUnitsGiven::automatic;  ///< automatic: by the format, or inferred from the numbers
  Duration imu_time_offset{};  ///< added to the times of IMU samples (and of fixes of the same device)
};

/// One of a data set's sensors.
struct SensorInfo {
  std::string name;  ///< file or folder it comes from
  SensorKind kind = SensorKind::lidar;
  std::optional<std::size_t> count;  ///< packets, where that is known without reading all
  std::string remark;                ///< what a reader should know of it
};

struct DatasetInfo {
  DatasetKind kind = DatasetKind::clouds;
  std::filesystem::path path;
  std::string name;  ///< the folder's, to call a session by
  std::vector<SensorInfo> sensors;
  std::optional<Timestamp> start, end;            ///< of the scans, where known without reading all
  SE3d T_body_lidar;                              ///< mounting; body = the IMU, or the LiDAR if there is none
  bool extrinsic_known = true;                    ///< false: nothing states it, and it is the identity
  std::optional<Eigen::Vector3d> p_body_antenna;  ///< of the GNSS antenna, where known
  bool motion_corrected = false;                  ///< scans are snapshots already
  bool has_odometry = false;                      ///< `next_frame` yields the frames of a recorded odometry
  std::optional<KeyframeOptions> keyframes{};     ///< how those with a scan were picked, where the recording says so
  std::filesystem::path truth{};                  ///< file with the true trajectory; empty if there is none
  std::string truth_frame{};                      ///< truths of sessions with the same are in one frame; empty: its own
  std::string source{};                           ///< how the data came about, where they are not recorded throughout
  std::vector<std::string> notes;                 ///< how the data were read
  std::vector<std::string> warnings;              ///< what looks wrong, and what can be done
};

/// A recording, read once from its start to its end, one scan in memory at a time.
class Dataset {
 public:
  Dataset() = default;
  Dataset(const Dataset&) = delete;
  Dataset& operator=(const Dataset&) = delete;
  virtual ~Dataset() = default;

  /// The next packet in time order; a scan counts at its end. @throws IoError naming the file that cannot be read.
  [[nodiscard]] virtual std::optional<Packet> next() = 0;

  /// The next frame of the recorded odometry, if `info().has_odometry`; takes the same scans as `next`.
  /// Frames without a scan are no keyframes.
  [[nodiscard]] virtual std::optional<Frame> next_frame() { return std::nullopt; }

  /// The fixes that came before the frame that `next_frame` gave last; after the last frame, those behind it. Each
  /// once.
  [[nodiscard]] virtual std::vector<GnssFix> take_fixes() { return {}; }

  /// What is known of the recording; warnings met while reading are added as they are met: while another thread reads,
  /// nobody may look at these.
  [[nodiscard]] const DatasetInfo& info() const { return info_; }

  /// The true trajectory T_map_body, if the data set has one. @throws IoError if its file cannot be read.
  [[nodiscard]] virtual std::optional<Trajectory> truth() const;

 protected:
  DatasetInfo info_;
};

/// What kind of data set a folder holds, or a file is, by names; nothing if none is known.
[[nodiscard]] std::optional<DatasetKind> recognize(const std::filesystem::path& path);

/// Opens a data set of any known kind, a folder or a file.
/// @throws IoError if the folder is of no known kind, with the trees that are known beside what was found; or if it is
///   of a known kind, but a file of it is missing or damaged.
[[nodiscard]] std::unique_ptr<Dataset> open_dataset(const std::filesystem::path& path,
                                                    const DatasetOptions& options = {});

/// Openers of each kind, for folders that are known to be of it. See the reader's own file for the layout.
/// @{
[[nodiscard]] std::unique_ptr<Dataset> open_nclt(const std::filesystem::path& path, const DatasetOptions& options);
[[nodiscard]] std::unique_ptr<Dataset> open_range_images(const std::filesystem::path& path,
                                                         const DatasetOptions& options);
[[nodiscard]] std::unique_ptr<Dataset> open_keyframes(const std::filesystem::path& path, const DatasetOptions& options);
[[nodiscard]] std::unique_ptr<Dataset> open_kitti(const std::filesystem::path& path, const DatasetOptions& options);
[[nodiscard]] std::unique_ptr<Dataset> open_kitti_raw(const std::filesystem::path& path, const DatasetOptions& options);
[[nodiscard]] std::unique_ptr<Dataset> open_mulran(const std::filesystem::path& path, const DatasetOptions& options);
[[nodiscard]] std::unique_ptr<Dataset> open_helipr(const std::filesystem::path& path, const DatasetOptions& options);
[[nodiscard]] std::unique_ptr<Dataset> open_newer_college(const std::filesystem::path& path,
                                                          const DatasetOptions& options);
[[nodiscard]] std::unique_ptr<Dataset> open_ros(const std::filesystem::path& path, const DatasetOptions& options);
[[nodiscard]] std::unique_ptr<Dataset> open_nuscenes(const std::filesystem::path& path, const DatasetOptions& options);
[[nodiscard]] std::unique_ptr<Dataset> open_clouds(const std::filesystem::path& path, const DatasetOptions& options);
/// @}

}  // namespace chainslam::datasets
