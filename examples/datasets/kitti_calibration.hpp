#pragma once

#include <array>
#include <cstddef>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "chainslam/lie/se3.hpp"

namespace chainslam::datasets {

/// A calibration file of KITTI: lines `name: number number ...`; lines of other things are passed over.
class KittiCalibration {
 public:
  /// @throws IoError if the file cannot be read.
  explicit KittiCalibration(const std::filesystem::path& path);

  [[nodiscard]] bool has(const std::string& name) const { return entries_.contains(name); }

  /// A row-major 3x4 matrix [R | t]. @throws IoError naming the entry if it is missing or no rigid motion.
  [[nodiscard]] SE3d matrix(const std::string& name) const;
  /// The same from the entries R and T. @throws as `matrix`.
  [[nodiscard]] SE3d rotation_and_translation() const;

 private:
  [[nodiscard]] const std::vector<double>& entry(const std::string& name, std::size_t count) const;
  [[nodiscard]] SE3d motion(const std::array<double, 9>& R, const Eigen::Vector3d& t, const std::string& name) const;

  std::filesystem::path path_;
  std::map<std::string, std::vector<double>> entries_;
};

}  // namespace chainslam::datasets
