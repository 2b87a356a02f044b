#pragma once

#include <filesystem>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/slam/occupancy_grid.hpp"
#include "chainslam/slam/slam_map.hpp"
#include "chainslam/trajectory/trajectory.hpp"
#include "colmap_export.hpp"
#include "las_export.hpp"

namespace chainslam::mapper {

enum class ExportFormat { tum, kitti, g2o, ply, pcd, las, grid, colmap };

struct ExportOptions {
  ExportFormat format = ExportFormat::tum;
  double voxel_size = 0.2;  ///< metres, of clouds; 0 keeps all points
  bool overwrite = false;
  ColmapExport colmap{};
  OccupancyGridOptions grid{};
  GnssFactorOptions earth{};  ///< of las: how fixes put the map on the Earth
};

/// Sessions that share a frame: those that were merged. `frame` is the session whose start defines it.
struct FrameGroup {
  SessionId frame;
  std::vector<SessionId> sessions;
};

/// The map's frames, in the order of the sessions that define them.
[[nodiscard]] std::vector<FrameGroup> frames_of(const SlamMap& map);

/// T_map_body of the keyframes of some sessions, in the order of time.
[[nodiscard]] Trajectory keyframe_trajectory(const SlamMap& map, const std::vector<SessionId>& sessions);

/// The scans of some sessions, placed by T_map_body and thinned.
[[nodiscard]] PointCloud<float> assembled_cloud(const SlamMap& map, const std::vector<SessionId>& sessions,
                                                double voxel_size);

/// Writes a map in another program's format:
/// - tum, kitti: a folder with `session_0.tum`, ... and `joint.tum`, all sessions of one frame in the order of time,
///   and `frames.csv` with the health of every frame if the map has them
/// - g2o: keyframes, odometry and closures with their information; the first keyframe of each frame is fixed
/// - ply, pcd: all scans, thinned, in one file
/// - las: all scans, downsampled, georeferenced where fixes allow it
/// - grid: an occupancy grid for ROS's map server, NAME.yaml and NAME.pgm
/// - colmap: a folder with `cameras.txt`, `images.txt` and `points3D.txt`: all of them or none
/// Where sessions were not merged, each frame has a file or model of its own, `..._frame_N`, but for g2o's.
/// What cannot be written is reported, and the rest is written.
/// @returns what to tell the shell. @throws IoError if nothing can be written.
[[nodiscard]] int export_map(const SlamMap& map, const std::filesystem::path& out, const ExportOptions& options);

}  // namespace chainslam::mapper
