#include "map_export.hpp"

#include <algorithm>
#include <cstdio>
#include <numeric>
#include <stdexcept>
#include <string>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/error.hpp"
#include "chainslam/io/g2o.hpp"
#include "chainslam/io/pcd.hpp"
#include "chainslam/io/ply.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "exit_code.hpp"
#include "frame_table.hpp"
#include "grid_export.hpp"
#include "output.hpp"
#include "support/configuration.hpp"

namespace chainslam::mapper {

namespace fs = std::filesystem;

namespace {

const Session& session_of(const SlamMap& map, SessionId id) { return map.sessions[static_cast<std::size_t>(id.value)]; }

const Keyframe& keyframe_of(const SlamMap& map, Index i) { return map.keyframes[static_cast<std::size_t>(i)]; }

void write_trajectory(const FileTarget& target, const Trajectory& trajectory, ExportFormat format) {
  if (format == ExportFormat::tum)
    write_tum(target, trajectory);
  else
    write_kitti_poses(target, trajectory);
}

void print_written(const fs::path& path) { std::printf("written      %s\n", printable(path.native()).c_str()); }

int export_trajectories(const SlamMap& map, const fs::path& out, const ExportOptions& options) {
  const std::string ending = options.format == ExportFormat::tum ? ".tum" : ".kitti.txt";
  OutputFolder folder(out, options.overwrite);
  std::vector<std::string> names;
  const auto write = [&](const std::string& name, const std::vector<SessionId>& sessions) {
    const Trajectory trajectory = keyframe_trajectory(map, sessions);
    if (folder.file(name + ending,
                    [&](const FileTarget& target) { write_trajectory(target, trajectory, options.format); }))
      names.push_back(name + ending);
  };
  for (const Session& session : map.sessions) write("session_" + std::to_string(session.id.value), {session.id});
  const std::vector<FrameGroup> groups = frames_of(map);
  for (const FrameGroup& group : groups)
    write(groups.size() == 1 ? "joint" : "joint_frame_" + std::to_string(group.frame.value), group.sessions);
  if (!map.frames.empty() && folder.file("frames.csv", [&](const FileTarget& target) { write_frames(target, map); }))
    names.emplace_back("frames.csv");
  if (names.empty()) return folder.exit_code(exit_output);
  folder.commit();
  for (const std::string& name : names) print_written(folder.target() / name);
  return folder.exit_code(exit_good);
}

int export_graph(const SlamMap& map, const fs::path& out, const ExportOptions& options) {
  G2oFile graph;
  const auto add_edge = [&](KeyframeId from, KeyframeId to, const SE3d& T_from_to, const SqrtInformation<6>& root) {
    graph.spatial.edges.push_back(
        {.from = from.value, .to = to.value, .measurement = T_from_to, .information = root.transpose() * root});
  };
  for (const Keyframe& keyframe : map.keyframes)
    graph.spatial.vertices.push_back({keyframe.id.value, keyframe.T_map_body});
  for (const FrameGroup& group : frames_of(map))
    if (session_of(map, group.frame).keyframes > 0) graph.fixed.push_back(session_of(map, group.frame).first_keyframe);
  for (const OdometryMeasurement& step : map.odometry)
    add_edge(step.from, step.to, step.T_from_to, step.sqrt_information);
  for (const LoopClosure& closure : map.closures)
    add_edge(closure.from, closure.to, closure.T_from_to, closure.sqrt_information);
  Output output(options.overwrite);
  if (output.file(out, [&](const FileTarget& target) { write_g2o(target, graph); })) print_written(out);
  return output.exit_code(exit_good);
}

/// `out` itself if there is one frame, else with the frame's number in its name.
fs::path path_of(const FrameGroup& group, std::size_t groups, const fs::path& out) {
  if (groups == 1) return out;
  fs::path path = out.has_filename() ? out : out.parent_path();  // DIR/ is DIR
  return path.replace_filename(path.stem().string() + "_frame_" + std::to_string(group.frame.value) +
                               path.extension().string());
}

int export_colmap(const SlamMap& map, const fs::path& out, const ExportOptions& options) {
  int exit_code = exit_good;
  const std::vector<FrameGroup> groups = frames_of(map);
  for (const FrameGroup& group : groups) {
    OutputFolder folder(path_of(group, groups.size(), out), options.overwrite);
    folder.drop_all_unless_committed();
    const PointCloud<float> cloud = assembled_cloud(map, group.sessions, options.voxel_size);
    const SE3d& T_body_camera = options.colmap.T_body_camera;
    const bool whole = folder.file("cameras.txt", [&](const auto& file) {
      write_colmap_cameras(file, options.colmap.camera);
    }) && folder.file("images.txt", [&](const auto& file) {
      write_colmap_images(file, map, group.sessions, T_body_camera);
    }) && folder.file("points3D.txt", [&](const auto& file) { write_colmap_points(file, cloud); });
    if (!whole) {
      exit_code = folder.exit_code(exit_output);
      continue;
    }
    folder.commit();
    for (const char* name : {"cameras.txt", "images.txt", "points3D.txt"}) print_written(folder.target() / name);
  }
  return exit_code;
}

int export_clouds(const SlamMap& map, const fs::path& out, const ExportOptions& options) {
  const std::vector<FrameGroup> groups = frames_of(map);
  Output output(options.overwrite);
  for (const FrameGroup& group : groups) {
    const fs::path path = path_of(group, groups.size(), out);
    const PointCloud<float> cloud = assembled_cloud(map, group.sessions, options.voxel_size);
    const auto write = [&](const FileTarget& target) {
      if (options.format == ExportFormat::ply)
        write_ply(target, cloud);
      else
        write_pcd(target, cloud);
    };
    if (output.file(path, write)) print_written(path);
  }
  return output.exit_code(exit_good);
}

int export_las(const SlamMap& map, const fs::path& out, const ExportOptions& options) {
  const std::vector<FrameGroup> groups = frames_of(map);
  Output output(options.overwrite);
  for (const FrameGroup& group : groups) {
    const fs::path path = path_of(group, groups.size(), out);
    std::vector<std::string> account;
    if (!output.file(path, [&](const FileTarget& target) {
          account = write_las(target, map, group.sessions, {options.voxel_size, options.earth});
        }))
      continue;
    print_written(path);
    for (const std::string& line : account) std::printf("%s\n", line.c_str());
  }
  return output.exit_code(exit_good);
}

OccupancyGrid<> grid_of(const SlamMap& map, const FrameGroup& group, const OccupancyGridOptions& options) {
  try {
    return occupancy_grid(map, group.sessions, options);
  } catch (const std::length_error&) {
    throw support::ConfigError("--resolution", "the grid would be too large",
                               "more than " + std::to_string(options.max_cells) + " cells",
                               "choose larger cells, or a shorter --range");
  }
}

int export_grids(const SlamMap& map, const fs::path& out, const ExportOptions& options) {
  const std::vector<FrameGroup> groups = frames_of(map);
  Output output(options.overwrite);
  for (const FrameGroup& group : groups) {
    const GridFiles files = grid_files(path_of(group, groups.size(), out));
    for (const fs::path& file : {files.image, files.yaml}) require_free(file, options.overwrite);
    const OccupancyGrid<> grid = grid_of(map, group, options.grid);
    if (grid.cells.empty()) {
      std::fprintf(stderr, "note: no grid for frame %d: none of its scans has a return in range\n", group.frame.value);
      continue;
    }
    const bool written = output.file(files.image, [&](const FileTarget& target) { write_grid_image(target, grid); }) &&
                         output.file(files.yaml, [&](const FileTarget& target) {
                           write_grid_yaml(target, grid, files.image.filename().native());
                         });
    if (!written) continue;
    print_written(files.yaml);
    std::printf("grid         %d x %d cells of %g m\n", grid.width, grid.height, grid.resolution);
  }
  return output.exit_code(exit_good);
}

}  // namespace

std::vector<FrameGroup> frames_of(const SlamMap& map) {
  std::vector<FrameGroup> groups;
  for (const Session& session : map.sessions) {
    const SessionId frame = session.frame.valid() ? session.frame : session.id;
    const auto group = std::ranges::find(groups, frame, &FrameGroup::frame);
    if (group == groups.end())
      groups.push_back({frame, {session.id}});
    else
      group->sessions.push_back(session.id);
  }
  return groups;
}

Trajectory keyframe_trajectory(const SlamMap& map, const std::vector<SessionId>& sessions) {
  Trajectory trajectory;
  for (const SessionId id : sessions)
    for (Index i = session_of(map, id).first_keyframe; i < session_of(map, id).end_keyframe(); ++i) {
      trajectory.times.push_back(keyframe_of(map, i).time);
      trajectory.poses.push_back(keyframe_of(map, i).T_map_body);
    }
  std::vector<Index> order(trajectory.size());
  std::iota(order.begin(), order.end(), 0);
  std::ranges::stable_sort(order, {}, [&](Index i) { return trajectory.times[static_cast<std::size_t>(i)]; });
  return subset(trajectory, order);
}

PointCloud<float> assembled_cloud(const SlamMap& map, const std::vector<SessionId>& sessions, double voxel_size) {
  // Folded now and then, so that memory holds the map and not all scans at once.
  constexpr std::size_t fold_at = 8'000'000;
  PointCloud<float> points;
  std::size_t folded = 0;
  const auto fold = [&] {
    if (voxel_size > 0) points = voxel_downsample(points, voxel_size, VoxelMode::first);
    folded = points.size();
  };
  for (const SessionId id : sessions)
    for (Index i = session_of(map, id).first_keyframe; i < session_of(map, id).end_keyframe(); ++i) {
      const Keyframe& keyframe = keyframe_of(map, i);
      if (!keyframe.cloud) continue;
      const PointCloud<float> placed = transformed(keyframe.cloud.load()->positions, keyframe.T_map_body);
      points.positions.insert(points.positions.end(), placed.positions.begin(), placed.positions.end());
      if (points.size() > fold_at + 2 * folded) fold();
    }
  fold();
  return points;
}

int export_map(const SlamMap& map, const fs::path& out, const ExportOptions& options) {
  switch (options.format) {
    case ExportFormat::tum:
    case ExportFormat::kitti:
      return export_trajectories(map, out, options);
    case ExportFormat::g2o:
      return export_graph(map, out, options);
    case ExportFormat::ply:
    case ExportFormat::pcd:
      return export_clouds(map, out, options);
    case ExportFormat::las:
      return export_las(map, out, options);
    case ExportFormat::grid:
      return export_grids(map, out, options);
    case ExportFormat::colmap:
      return export_colmap(map, out, options);
  }
  return exit_good;
}

}  // namespace chainslam::mapper
