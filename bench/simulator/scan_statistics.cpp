// How real and simulated scans compare: range noise, bias from laser to laser, returns, density over range, and what
// moves, as Markdown: see bench/results.md.

#include <CLI/CLI.hpp>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <limits>
#include <map>
#include <memory>
#include <numbers>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "chainslam/search/kd_tree.hpp"
#include "datasets/dataset.hpp"
#include "simulator/preset.hpp"
#include "simulator/town_drive.hpp"
#include "support/semi_real_drives.hpp"
#include "table_file.hpp"

namespace chainslam::bench {
namespace {

constexpr std::array<double, 6> range_bins{5, 10, 20, 40, 80, 1e9};  // upper ends, metres

/// Scans and where they were taken.
struct ScanSeries {
  std::vector<LidarScan> scans;
  std::vector<SE3d> T_map_lidar;  ///< at the scans' ends; empty if that is not known
};

double median(std::vector<double> values) {
  if (values.empty()) return 0.0;
  const auto middle = values.begin() + std::ssize(values) / 2;
  std::ranges::nth_element(values, middle);
  return *middle;
}

/// Standard deviation by the median absolute deviation: outliers count little.
double robust_deviation(const std::vector<double>& values) {
  const double middle = median(values);
  std::vector<double> off;
  for (const double value : values) off.push_back(std::abs(value - middle));
  return 1.4826 * median(off);
}

/// What scans came to.
class Statistics {
 public:
  void add(const LidarScan& scan) {
    const auto& points = scan.cloud.positions;
    ++scans_;
    points_ += points.size();
    for (const Eigen::Vector3f& p : points) {
      const auto range = static_cast<double>(p.norm());
      ++by_range_[bin(range)];
    }
    const KdTree<float> tree(scan.cloud);
    const std::size_t stride = 1 + points.size() / 4000;
    for (std::size_t i = 0; i < points.size(); i += stride) add_residual(tree, points, i);
  }

  /// @param later  a scan some time later. @param T_later_earlier  the motion between both.
  void add_pair(const LidarScan& earlier, const LidarScan& later, const SE3d& T_later_earlier) {
    const std::vector<float> image = nearest_in_sight(later);
    for (const Eigen::Vector3f& p : earlier.cloud.positions) {
      const Eigen::Vector3d q = T_later_earlier * p.cast<double>();
      const double range = q.norm();
      if (range < 3.0 || range > 40.0 || q.z() < -1.2) continue;  // the ground, seen at a slant, would count
      const float seen = least_around(image, q);
      if (seen == 0.0F) continue;
      ++looked_at_;
      seen_through_ += static_cast<double>(seen) > range + 1.0;
    }
  }

  /// Cells of a table's row.
  [[nodiscard]] std::string row(double rays) const {
    std::vector<double> all, medians;
    for (const auto& [elevation, values] : residuals_) {
      all.insert(all.end(), values.begin(), values.end());
      if (values.size() >= 50) medians.push_back(median(values));
    }
    double squares = 0.0;
    for (const double one : medians) squares += one * one / static_cast<double>(medians.size());
    std::string text =
        printed(" | %.1f cm", 100.0 * robust_deviation(all)) + printed(" | %.1f cm", 100.0 * std::sqrt(squares));
    const double per_scan = static_cast<double>(points_) / static_cast<double>(scans_);
    text += rays > 0.0 ? printed(" | %.0f %%", 100.0 * per_scan / rays) : " | –";
    for (const std::size_t count : by_range_)
      text += printed(" | %.0f", 100.0 * static_cast<double>(count) / static_cast<double>(points_));
    return text + (looked_at_ > 1000 ? printed(" | %.1f %% |\n", 100.0 * static_cast<double>(seen_through_) /
                                                                     static_cast<double>(looked_at_))
                                     : " | – |\n");
  }

 private:
  static constexpr int columns = 360, rows = 60;  // of an image of ranges: a degree each, from 30 degrees down to 30 up

  static std::string printed(const char* format, double value) {
    std::array<char, 64> text{};
    std::snprintf(text.data(), text.size(), format, value);
    return text.data();
  }

  static std::size_t bin(double range) {
    std::size_t i = 0;
    while (range > range_bins[i]) ++i;
    return i;
  }

  static std::pair<int, int> pixel(const Eigen::Vector3d& p) {
    constexpr double degrees = 180.0 / std::numbers::pi;
    return {static_cast<int>(std::atan2(p.y(), p.x()) * degrees + 180.0) % columns,
            static_cast<int>(std::asin(p.z() / p.norm()) * degrees + 30.0)};
  }

  /// The nearest range in each pixel, 0 where there is none.
  static std::vector<float> nearest_in_sight(const LidarScan& scan) {
    std::vector<float> image(static_cast<std::size_t>(columns * rows), 0.0F);
    for (const Eigen::Vector3f& p : scan.cloud.positions) {
      const auto [column, row] = pixel(p.cast<double>());
      if (row < 0 || row >= rows) continue;
      float& nearest = image[static_cast<std::size_t>(row * columns + column)];
      const float range = p.norm();
      if (nearest == 0.0F || range < nearest) nearest = range;
    }
    return image;
  }

  /// The least range in the pixels around; 0 if one of them is empty.
  static float least_around(const std::vector<float>& image, const Eigen::Vector3d& p) {
    const auto [column, row] = pixel(p);
    if (row < 1 || row + 1 >= rows) return 0.0F;
    float least = std::numeric_limits<float>::infinity();
    for (int y = row - 1; y <= row + 1; ++y)
      for (int x = column - 1; x <= column + 1; ++x) {
        const float range = image[static_cast<std::size_t>(y * columns + (x + columns) % columns)];
        if (range == 0.0F) return 0.0F;
        least = std::min(least, range);
      }
    return least;
  }

  /// How far a point lies, along its ray, from the plane of its neighbours, where they are one.
  void add_residual(const KdTree<float>& tree, const std::vector<Eigen::Vector3f>& points, std::size_t i) {
    const Eigen::Vector3d p = points[i].cast<double>();
    const double range = p.norm();
    if (range < 3.0 || range > 40.0) return;
    std::array<Neighbor<float>, 21> found;
    const auto count = static_cast<std::size_t>(tree.knn(points[i], found));
    if (count < found.size()) return;
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    std::vector<Eigen::Vector3d> around;
    for (const auto& neighbor : found)
      if (static_cast<std::size_t>(neighbor.index) != i)
        around.push_back(points[static_cast<std::size_t>(neighbor.index)].cast<double>());
    for (const Eigen::Vector3d& q : around) mean += q / static_cast<double>(around.size());
    Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
    for (const Eigen::Vector3d& q : around) covariance += (q - mean) * (q - mean).transpose();
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(covariance);
    if (eigen.eigenvalues()[1] < 25.0 * eigen.eigenvalues()[0]) return;
    const Eigen::Vector3d normal = eigen.eigenvectors().col(0);
    const double cosine = normal.dot(p) / range;
    if (std::abs(cosine) < 0.3) return;
    const auto elevation = static_cast<int>(std::floor(std::asin(p.z() / range) * 180.0 / std::numbers::pi / 0.4));
    residuals_[elevation].push_back(normal.dot(p - mean) / cosine);
  }

  std::size_t scans_ = 0, points_ = 0, looked_at_ = 0, seen_through_ = 0;
  std::array<std::size_t, range_bins.size()> by_range_{};
  std::map<int, std::vector<double>> residuals_;  ///< by elevation in steps of 0.4 degrees, metres
};

template <class Next>
ScanSeries read_series(const Next& next, const std::optional<Trajectory>& truth, const SE3d& T_body_lidar, int count) {
  ScanSeries series;
  while (std::ssize(series.scans) < count) {
    const std::optional<Packet> packet = next();
    if (!packet) break;
    if (const auto* scan = std::get_if<LidarScan>(&*packet)) series.scans.push_back(*scan);
  }
  if (!truth) return series;
  for (const LidarScan& scan : series.scans) {
    const auto at = std::ranges::lower_bound(truth->times, scan.end);
    const auto i = std::min(static_cast<std::size_t>(at - truth->times.begin()), truth->size() - 1);
    series.T_map_lidar.push_back(truth->poses[i] * T_body_lidar);
  }
  return series;
}

/// A data set's folder; "semi-real:07"; or "PRESET/SIZE/SESSION" of the simulator.
ScanSeries open_series(const std::string& name, int count) {
  if (name.starts_with("semi-real:")) {
    for (const test::KittiSequence& sequence : test::kitti_imu_sequences)
      if (name.substr(10) == sequence.name)
        if (const auto drive = test::semi_real_drive(sequence))
          return read_series([&] { return drive->next(); }, drive->truth_at_scan_ends(),
                             drive->options().lidar.T_body_lidar, count);
    throw std::invalid_argument("there is no drive " + name);
  }
  const std::size_t slash = name.find('/'), second = name.find('/', slash + 1);
  if (second != std::string::npos)
    if (const auto size = simulator::preset_size(name.substr(slash + 1, second - slash - 1)))
      if (const auto preset = simulator::preset(name.substr(0, slash), *size)) {
        simulator::TownDrive drive(*preset, 1, static_cast<std::size_t>(std::stoi(name.substr(second + 1)) - 1));
        return read_series([&] { return drive.next(); }, drive.truth_at_scan_ends(), preset->lidar.T_body_lidar, count);
      }
  const auto dataset = datasets::open_dataset(name);
  return read_series([&] { return dataset->next(); }, dataset->truth(), dataset->info().T_body_lidar, count);
}

std::string table(const std::vector<std::string>& series, int count) {
  std::string text =
      "| scans | range noise | from laser to laser | returns | 0-5 m | 5-10 | 10-20 | 20-40 | 40-80 | 80- | seen "
      "through a second later |\n|---|---|---|---|---|---|---|---|---|---|---|\n";
  for (const std::string& one : series) {
    // NAME=RAYS=WHERE
    const std::size_t first = one.find('='), second = one.find('=', first + 1);
    if (second == std::string::npos) throw std::invalid_argument("write NAME=RAYS=WHERE, not " + one);
    const ScanSeries scans = open_series(one.substr(second + 1), count);
    Statistics statistics;
    for (std::size_t i = 0; i < scans.scans.size(); i += 5) statistics.add(scans.scans[i]);
    for (std::size_t i = 0; i < scans.T_map_lidar.size(); i += 5)
      for (std::size_t k = i + 1; k < scans.T_map_lidar.size(); ++k)
        if (const double gap = to_seconds(scans.scans[k].time - scans.scans[i].time); gap > 0.95) {
          if (gap < 1.3)
            statistics.add_pair(scans.scans[i], scans.scans[k], scans.T_map_lidar[k].inverse() * scans.T_map_lidar[i]);
          break;
        }
    text += "| " + one.substr(0, first) + statistics.row(std::stod(one.substr(first + 1, second - first - 1)));
    std::fprintf(stderr, "%s: %zu scans\n", one.c_str(), scans.scans.size());
  }
  return text;
}

}  // namespace
}  // namespace chainslam::bench

int main(int count, char** words) {
  using namespace chainslam;
  std::filesystem::path out;
  std::vector<std::string> series;
  int scans = 100;
  CLI::App app("Statistics of real and simulated scans, as Markdown");
  app.add_option("--out", out, "where the table goes")->required();
  app.add_option("--scans", scans, "of each series, of which one in five is looked at (default 100)")
      ->check(CLI::PositiveNumber);
  app.add_option("series", series,
                 "NAME=RAYS=WHERE: rays in a scan, 0 if not known; a data set's folder, "
                 "semi-real:07, or PRESET/SIZE/SESSION of the simulator")
      ->required();
  CLI11_PARSE(app, count, words);
  return bench::write_table("bench_scan_statistics", out, [&] { return bench::table(series, scans); });
}
