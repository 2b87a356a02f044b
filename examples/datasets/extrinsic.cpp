#include "datasets/extrinsic.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>

#include "chainslam/core/error.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/io/input_file.hpp"
#include "datasets/kitti_calibration.hpp"

namespace chainslam::datasets {
namespace {

namespace fs = std::filesystem;

SO3d of_angles(double roll_deg, double pitch_deg, double yaw_deg) {
  constexpr double degree = std::numbers::pi / 180;
  return SO3d::exp(yaw_deg * degree * Eigen::Vector3d::UnitZ()) *
         SO3d::exp(pitch_deg * degree * Eigen::Vector3d::UnitY()) *
         SO3d::exp(roll_deg * degree * Eigen::Vector3d::UnitX());
}

PoseNumbers of_quaternion(std::span<const double> v) {
  const Eigen::Quaterniond q(v[6], v[3], v[4], v[5]);
  constexpr double rounding = 0.01;  // of three decimals, and a sum of them
  if (!(std::abs(q.norm() - 1) <= rounding))
    return {.problem = "a quaternion qx qy qz qw of length " + std::to_string(q.norm()) + " instead of 1"};
  return {.pose = SE3d(SO3d::from_quaternion(q.normalized()), {v[0], v[1], v[2]})};
}

PoseNumbers of_matrix(std::span<const double> v) {
  Eigen::Matrix3d R;
  R << v[0], v[1], v[2], v[4], v[5], v[6], v[8], v[9], v[10];
  const Eigen::Matrix3d defect = R.transpose() * R - Eigen::Matrix3d::Identity();
  if (!(defect.cwiseAbs().maxCoeff() <= 0.01) || R.determinant() < 0)
    return {.problem = "a matrix whose left 3x3 part is no rotation"};
  const bool last_row_fits = v.size() == 12 || (v[12] == 0 && v[13] == 0 && v[14] == 0 && v[15] == 1);
  if (!last_row_fits) return {.problem = "a 4x4 matrix whose last row is not 0 0 0 1"};
  return {.pose = SE3d(SO3d::from_matrix(R), {v[3], v[7], v[11]})};
}

SE3d read_pose(const fs::path& path) {
  InputFile file(path);
  std::vector<double> numbers;
  while (const auto line = file.read_line()) {
    std::string text(*line);
    std::ranges::replace_if(
        text, [](char c) { return c == ',' || c == ';'; }, ' ');
    if (detail::trimmed(text).starts_with('#')) continue;
    LineFields fields(file, text);
    while (fields.more()) numbers.push_back(fields.number("pose"));
  }
  const PoseNumbers found = pose_of_numbers(numbers);
  if (!found.pose) throw_input_error(path.string(), "", found.problem, std::string("write ") + pose_layouts);
  return *found.pose;
}

}  // namespace

PoseNumbers pose_of_numbers(std::span<const double> v) {
  if (!std::ranges::all_of(v, [](double value) { return is_finite(value); }))
    return {.problem = "a number that is not finite"};
  switch (v.size()) {
    case 6:
      return {.pose = SE3d(of_angles(v[3], v[4], v[5]), {v[0], v[1], v[2]})};
    case 7:
      return of_quaternion(v);
    case 12:
    case 16:
      return of_matrix(v);
    default:
      return {.problem = std::to_string(v.size()) + " numbers, which are no pose"};
  }
}

std::optional<StatedExtrinsic> find_extrinsic(const std::vector<fs::path>& places) {
  for (const fs::path& place : places) {
    const fs::path own = place / "T_body_lidar.txt", kitti = place / "calib_imu_to_velo.txt";
    if (fs::is_regular_file(own)) return StatedExtrinsic{read_pose(own), own.filename().string()};
    if (fs::is_regular_file(kitti))
      return StatedExtrinsic{KittiCalibration(kitti).rotation_and_translation().inverse(), kitti.filename().string()};
  }
  return std::nullopt;
}

void set_extrinsic(const DatasetOptions& options, const std::optional<StatedExtrinsic>& stated, bool has_imu,
                   DatasetInfo& info) {
  if (options.T_body_lidar) {
    info.T_body_lidar = *options.T_body_lidar;
    info.notes.push_back("T_body_lidar as set by dataset.T_body_lidar" +
                         (stated ? "; that of " + stated->source + " is not used" : ""));
  } else if (stated && has_imu) {
    info.T_body_lidar = stated->T_body_lidar;
    info.notes.push_back("T_body_lidar from " + stated->source);
  } else {
    info.T_body_lidar = SE3d();
    info.extrinsic_known = !has_imu;
    if (has_imu)
      info.warnings.emplace_back(
          "nothing states where the LiDAR sits on the IMU, so they are taken to be at one place with the same axes: "
          "set "
          "dataset.T_body_lidar, or write T_body_lidar.txt beside the data");
  }
}

}  // namespace chainslam::datasets
