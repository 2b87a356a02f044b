#include "recorded_input.hpp"

#include <algorithm>
#include <cstdio>
#include <optional>
#include <string_view>

#include "chainslam/core/error.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "datasets/files.hpp"
#include "datasets/kitti_calibration.hpp"
#include "simulator/rig.hpp"
#include "support/configuration.hpp"

namespace chainslam::mapper {

namespace {

namespace fs = std::filesystem;

std::string shown(double value) {
  char text[32];
  std::snprintf(text, sizeof(text), "%.3g", value);
  return text;
}

/// A pose from a file: rows of a 3x4 or 4x4 matrix, or KITTI's calibration with `Tr` or with `R` and `T`, which state
/// its inverse where they are those of calib_imu_to_velo.txt.
SE3d read_extrinsic(const fs::path& path, bool inverted) {
  InputFile file(path);
  const auto line = file.read_line();
  if (line && line->find(':') != std::string_view::npos) {
    const datasets::KittiCalibration calibration(path);
    if (inverted) return calibration.rotation_and_translation().inverse();
    return calibration.has("Tr") ? calibration.matrix("Tr") : calibration.rotation_and_translation();
  }
  std::vector<double> values;
  InputFile rows(path);
  while (const auto row = rows.read_line())
    for (LineFields fields(rows, *row); fields.more();) values.push_back(fields.number("matrix"));
  if (values.size() == 16) values.resize(12);
  if (values.size() != 12)
    rows.fail("", std::to_string(values.size()) + " numbers", "write the 3 or 4 rows of a pose matrix");
  Eigen::Matrix3d R;
  Eigen::Vector3d t;
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) R(i, k) = values[static_cast<std::size_t>(4 * i + k)];
    t[i] = values[static_cast<std::size_t>(4 * i + 3)];
  }
  if (!((R.transpose() * R - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff() < 1e-3) || R.determinant() < 0)
    rows.fail("", "a matrix that is no rotation", "write the pose as [R | t]");
  return SE3d(SO3d::from_matrix(R), t);
}

SE3d body_lidar(const SimulateArguments& arguments, TrajectoryFormat format) {
  if (arguments.body_lidar == "kitti") return simulator::kitti_T_lidar_imu().inverse();
  if (!arguments.body_lidar.empty()) return read_extrinsic(arguments.body_lidar, true);
  return format == TrajectoryFormat::nclt_csv ? simulator::nominal_T_body_lidar() : SE3d();
}

SE3d camera_lidar(const SimulateArguments& arguments) {
  if (arguments.camera_lidar == "kitti") return simulator::kitti_T_camera_lidar();
  if (arguments.camera_lidar.empty())
    throw support::ConfigError("simulate", "a camera's trajectory needs the camera's place", "no --camera-lidar",
                               "give KITTI's calib.txt, a file with the matrix T_camera_lidar, or the word kitti");
  return read_extrinsic(arguments.camera_lidar, false);
}

/// Gives KITTI's rows their times.
std::vector<Timestamp> times_of_rows(const SimulateArguments& arguments, std::size_t rows) {
  std::vector<Timestamp> times;
  if (!arguments.times.empty()) {
    times = datasets::read_stamps(arguments.times);
    if (times.size() < rows)
      throw_input_error(arguments.times.string(), "",
                        std::to_string(times.size()) + " times for " + std::to_string(rows) + " poses",
                        "give one line for each pose");
    times.resize(rows);
    return times;
  }
  if (!arguments.rate)
    throw support::ConfigError("simulate", "the trajectory's rows have no times", arguments.trajectory.string(),
                               "give --times FILE with a line for each row, or --rate HZ");
  for (std::size_t i = 0; i < rows; ++i) times.push_back(Timestamp(seconds(static_cast<double>(i) / *arguments.rate)));
  return times;
}

/// The trajectory's frame seen from the body: T_body_frame.
SE3d frame_in_body(const SimulateArguments& arguments, TrajectoryFormat format, const SE3d& T_body_lidar) {
  std::string frame = arguments.frame;
  if (frame.empty()) frame = format == TrajectoryFormat::kitti && !arguments.camera_lidar.empty() ? "camera" : "body";
  if (frame == "lidar") return T_body_lidar;
  if (frame == "camera") return T_body_lidar * camera_lidar(arguments).inverse();
  return SE3d();
}

/// Drops the poses in intervals that touch the start or the end.
void cut_ends(Trajectory& trajectory, const std::vector<SkippedInterval>& skipped) {
  constexpr double touching = 0.5;  // seconds
  Timestamp start = trajectory.times.front(), end = trajectory.times.back();
  for (const SkippedInterval& interval : skipped) {
    const auto time = [](double value) { return Timestamp(seconds(std::clamp(value, -9e9, 9e9))); };  // what it can be
    const Timestamp from = time(interval.from), to = time(interval.to);
    if (from <= start + seconds(touching)) start = std::max(start, to);
    if (to >= end - seconds(touching)) end = std::min(end, from);
  }
  Trajectory kept;
  for (std::size_t i = 0; i < trajectory.size(); ++i) {
    if (trajectory.times[i] < start || trajectory.times[i] > end) continue;
    kept.times.push_back(trajectory.times[i]);
    kept.poses.push_back(trajectory.poses[i]);
  }
  trajectory = std::move(kept);
}

}  // namespace

void check_drive(const Trajectory& trajectory, const fs::path& path) {
  constexpr double fastest = 70.0, quickest = 15.0;  // m/s, rad/s
  constexpr double longest_gap = 2.0;                // seconds
  const auto fail = [&](std::size_t pose, const std::string& found, const std::string& remedy) {
    throw_input_error(path.string(), "pose " + std::to_string(pose + 1), found, remedy);
  };
  for (std::size_t i = 1; i < trajectory.size(); ++i) {
    const double dt = to_seconds(trajectory.times[i] - trajectory.times[i - 1]);
    if (dt <= 0.0) fail(i, "a time that is not later than the one before it", "sort the poses by time");
    if (dt > longest_gap)
      fail(i, "a gap of " + shown(dt) + " s before it",
           "give the part before or after it, for instance with --skip FROM:TO to the trajectory's start or end");
    const SE3d step = trajectory.poses[i - 1].inverse() * trajectory.poses[i];
    if (step.translation().norm() > fastest * dt || step.rotation().log().norm() > quickest * dt)
      fail(i,
           "a jump of " + shown(step.translation().norm()) + " m and " + shown(step.rotation().log().norm()) +
               " rad within " + shown(dt) + " s",
           "check the times and the units; leave the wrong poses out");
  }
  const double duration = trajectory.empty() ? 0.0 : to_seconds(trajectory.times.back() - trajectory.times.front());
  if (trajectory.size() < 10 || duration < 2.0 || path_length(trajectory) < 5.0)
    throw_input_error(path.string(), "",
                      std::to_string(trajectory.size()) + " poses, " + shown(duration) + " s, " +
                          shown(path_length(trajectory)) + " m",
                      "give a trajectory of at least 10 poses, 2 s and 5 m");
}

namespace {

/// T_map_body of another drive in the frame of the first; its poses are those of the same frame.
Trajectory read_other(const fs::path& path, const SE3d& T_body_frame) {
  Trajectory other = read_trajectory(path, NcltPoses::imu).trajectory;
  if (!other.has_times())
    throw support::ConfigError("--also " + path.string(), "a trajectory without times", "rows of 12 numbers",
                               "give one of TUM's, EuRoC's or NCLT's format");
  for (SE3d& pose : other.poses) pose = T_body_frame * pose * T_body_frame.inverse();
  check_drive(other, path);
  return other;
}

}  // namespace

RecordedInput read_recorded_input(const SimulateArguments& arguments) {
  TrajectoryFile file = read_trajectory(arguments.trajectory, NcltPoses::imu);
  RecordedInput input{.trajectory = std::move(file.trajectory),
                      .T_body_lidar = body_lidar(arguments, file.format),
                      .imu = {},
                      .imu_rows = {}};
  std::vector<Timestamp> frame_times;
  if (!input.trajectory.has_times())
    input.trajectory.times = frame_times = times_of_rows(arguments, input.trajectory.size());
  // Frames that are numbered lie between two poses.
  if (input.trajectory.size() < 2) check_drive(input.trajectory, arguments.trajectory);
  const SE3d T_body_frame = frame_in_body(arguments, file.format, input.T_body_lidar);
  for (SE3d& pose : input.trajectory.poses) pose = T_body_frame * pose * T_body_frame.inverse();
  const std::vector<SkippedInterval> skipped = read_skipped(arguments, frame_times);
  cut_ends(input.trajectory, skipped);
  check_drive(input.trajectory, arguments.trajectory);
  for (const fs::path& path : arguments.others) input.others.push_back(read_other(path, T_body_frame));
  if (!arguments.imu.empty()) read_recorded_imu(arguments, frame_times, skipped, input);
  return input;
}

}  // namespace chainslam::mapper
