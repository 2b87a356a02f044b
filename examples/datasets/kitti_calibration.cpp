#include "datasets/kitti_calibration.hpp"

#include <algorithm>
#include <string_view>

#include "chainslam/core/error.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/io/detail/text.hpp"
#include "chainslam/io/input_file.hpp"

namespace chainslam::datasets {

KittiCalibration::KittiCalibration(const std::filesystem::path& path) : path_(path) {
  InputFile file(path);
  while (const auto line = file.read_line()) {
    const std::size_t colon = line->find(':');
    if (colon == std::string_view::npos) continue;
    std::vector<double>& numbers = entries_[std::string(detail::trimmed(line->substr(0, colon)))];
    numbers.clear();
    for (std::string_view rest = detail::trimmed(line->substr(colon + 1)); !rest.empty();) {
      const std::size_t end = std::min(rest.find_first_of(detail::blanks), rest.size());
      const auto value = detail::parse_double(rest.substr(0, end));
      if (!value || !is_finite(*value)) break;  // such as calib_time
      numbers.push_back(*value);
      rest = detail::trimmed(rest.substr(end));
    }
  }
}

const std::vector<double>& KittiCalibration::entry(const std::string& name, std::size_t count) const {
  const auto found = entries_.find(name);
  if (found == entries_.end() || found->second.size() != count)
    throw_input_error(path_.string(), "entry " + name,
                      found == entries_.end() ? "no such line" : std::to_string(found->second.size()) + " numbers",
                      "the file should hold a line `" + name + ":` with " + std::to_string(count) + " numbers");
  return found->second;
}

SE3d KittiCalibration::motion(const std::array<double, 9>& R, const Eigen::Vector3d& t, const std::string& name) const {
  const Eigen::Matrix3d matrix = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(R.data());
  const Eigen::Matrix3d defect = matrix.transpose() * matrix - Eigen::Matrix3d::Identity();
  if (!(defect.cwiseAbs().maxCoeff() <= 1e-3) || matrix.determinant() < 0)
    throw_input_error(path_.string(), "entry " + name, "a matrix that is no rotation",
                      "the file is damaged: copy it again");
  return SE3d(SO3d::from_matrix(matrix), t);
}

SE3d KittiCalibration::matrix(const std::string& name) const {
  const std::vector<double>& m = entry(name, 12);
  return motion({m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]}, {m[3], m[7], m[11]}, name);
}

SE3d KittiCalibration::rotation_and_translation() const {
  const std::vector<double>& t = entry("T", 3);
  std::array<double, 9> R{};
  std::ranges::copy(entry("R", 9), R.begin());
  return motion(R, {t[0], t[1], t[2]}, "R");
}

}  // namespace chainslam::datasets
