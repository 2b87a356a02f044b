#include "trajectory_file.hpp"

#include <algorithm>
#include <array>
#include <optional>
#include <string>
#include <string_view>

#include "chainslam/core/types.hpp"
#include "chainslam/io/input_file.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "datasets/nclt.hpp"

namespace chainslam::mapper {

namespace {

constexpr const char* known_formats =
    "give TUM's `t x y z qx qy qz qw`, KITTI's 12 numbers a row, EuRoC's csv or NCLT's ground truth csv";

/// The next row that is neither empty nor a comment.
std::optional<std::string_view> next_row(InputFile& file) {
  while (const auto line = file.read_line()) {
    const auto begin = line->find_first_not_of(" \t");
    if (begin != std::string_view::npos && (*line)[begin] != '#') return line;
  }
  return std::nullopt;
}

int count_fields(LineFields fields) {
  int count = 0;
  for (; fields.more(); ++count) static_cast<void>(fields.text("row"));
  return count;
}

/// NCLT's ground truth: microseconds, metres, radians; R = Rz(heading) Ry(pitch) Rx(roll). Rows with NaN are left out.
void read_nclt_csv(TrajectoryFile& result) {
  InputFile file(result.path);
  while (const auto row = next_row(file)) {
    LineFields fields(file, *row, ',');
    const Timestamp time = Timestamp::from_microseconds(fields.integer("utime"));
    std::array<double, 6> pose{};
    constexpr std::array<const char*, 6> names = {"x", "y", "z", "roll", "pitch", "heading"};
    for (std::size_t i = 0; i < pose.size(); ++i) pose[i] = fields.number_or_nan(names[i]);
    fields.end("seven fields: utime, x, y, z, roll, pitch, heading");
    if (!result.trajectory.times.empty() && time < result.trajectory.times.back())
      fields.fail("utime", "a stamp that is earlier than the one before it", "sort the lines by time");
    if (!std::all_of(pose.begin(), pose.end(), [](double value) { return is_finite(value); })) {
      ++result.not_finite;
      continue;
    }
    const SO3d rotation = SO3d::exp({0, 0, pose[5]}) * SO3d::exp({0, pose[4], 0}) * SO3d::exp({pose[3], 0, 0});
    result.trajectory.times.push_back(time);
    result.trajectory.poses.push_back(SE3d(rotation, {pose[0], pose[1], pose[2]}));
  }
}

}  // namespace

const char* format_name(TrajectoryFormat format) {
  constexpr std::array<const char*, 4> names = {"TUM", "KITTI poses", "EuRoC csv", "NCLT ground truth csv"};
  return names[static_cast<std::size_t>(format)];
}

TrajectoryFormat trajectory_format(const std::filesystem::path& path) {
  InputFile file(path);
  const auto row = next_row(file);
  if (!row) file.fail("", "no pose", std::string("check that this is the right file; ") + known_formats);
  const bool commas = row->find(',') != std::string_view::npos;
  const int fields = count_fields(LineFields(file, *row, commas ? ',' : ' '));
  if (commas && fields == 7) return TrajectoryFormat::nclt_csv;
  if (commas && fields >= 8) return TrajectoryFormat::euroc_csv;
  if (!commas && fields == 12) return TrajectoryFormat::kitti;
  if (!commas && fields == 8) return TrajectoryFormat::tum;
  file.fail(file.place_of_line(),
            "a row of " + std::to_string(fields) + (commas ? " fields with commas" : " fields") +
                ", which is no trajectory that is known",
            known_formats);
}

TrajectoryFile read_trajectory(const std::filesystem::path& path, NcltPoses nclt_poses) {
  TrajectoryFile result;
  result.path = path;
  result.format = trajectory_format(path);
  switch (result.format) {
    case TrajectoryFormat::tum:
      result.trajectory = read_tum(path);
      break;
    case TrajectoryFormat::kitti:
      result.trajectory = read_kitti_poses(path);
      break;
    case TrajectoryFormat::euroc_csv:
      result.trajectory = read_euroc_csv(path);
      break;
    case TrajectoryFormat::nclt_csv:
      if (nclt_poses == NcltPoses::imu)
        result.trajectory = datasets::read_nclt_ground_truth(path);
      else
        read_nclt_csv(result);
      break;
  }
  if (result.trajectory.empty())
    throw_input_error(path.string(), "", "no pose with finite numbers", "check that this is the right file");
  if (result.trajectory.has_times()) {
    const std::size_t before = result.trajectory.size();
    result.trajectory = sorted_by_time(result.trajectory);
    result.repeated = to_index(before - result.trajectory.size());
  }
  return result;
}

}  // namespace chainslam::mapper
