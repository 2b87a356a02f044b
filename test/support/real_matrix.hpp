#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <fstream>
#include <stdexcept>

#include "chainslam/lie/se3.hpp"

namespace chainslam::test {

/// A pose from the first three rows of a 4 x 4 matrix in a text file. @throws std::runtime_error if they are not there.
inline SE3d read_matrix(const std::filesystem::path& path) {
  std::ifstream file(path);
  Eigen::Matrix3d R;
  Eigen::Vector3d t;
  for (Eigen::Index row = 0; row < 3; ++row) file >> R(row, 0) >> R(row, 1) >> R(row, 2) >> t[row];
  if (!file) throw std::runtime_error(path.string() + ": not a 4 x 4 matrix");
  return SE3d(SO3d::from_matrix(R), t);
}

}  // namespace chainslam::test
