#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numbers>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam::experiments {

/// How what is around a place becomes an image: azimuth from left to right over the whole turn, elevation from the
/// highest row down, equal angles.
struct PanoramaOptions {
  int columns = 360;
  int rows = 45;
  double highest_deg = 15.0, lowest_deg = -30.0;
  double most_range = 50.0;  ///< metres: the value 1; what is farther is as good as nothing
  double point_size = 0.3;   ///< metres, across: a map's points are drawn this large, so that it has no holes
  /// A surface is what so many scans have within this of each other, metres: what passed by once is not in the way.
  std::size_t scans_of_surface = 2;
  double depth_of_surface = 0.5;
};

/// Ranges as values from 0 (here) to 1 (`most_range` and more), row by row; NaN where there is no return.
struct Panorama {
  int columns = 0, rows = 0;
  std::vector<float> values;

  explicit Panorama(const PanoramaOptions& options)
      : columns(options.columns),
        rows(options.rows),
        values(static_cast<std::size_t>(options.columns) * static_cast<std::size_t>(options.rows),
               std::numeric_limits<float>::quiet_NaN()) {}

  /// The pixel of a row and of a column, which may lie a turn off.
  [[nodiscard]] std::size_t at(int row, int column) const {
    return static_cast<std::size_t>(row) * static_cast<std::size_t>(columns) +
           static_cast<std::size_t>((column % columns + columns) % columns);
  }
};

/// Draws points over what is there: the nearest one of a pixel is seen.
/// @param T_view_cloud  the view is at the origin, level with its own z axis.
/// @param size  of a point, metres across; 0 draws each into one pixel.
inline void draw(Panorama& image, const PanoramaOptions& options, const PointCloud<float>& cloud,
                 const SE3d& T_view_cloud, double size) {
  const Eigen::Matrix3f R = T_view_cloud.rotation().matrix().cast<float>();
  const Eigen::Vector3f t = T_view_cloud.translation().cast<float>();
  const auto most = static_cast<float>(options.most_range);
  const double columns_per_radian = options.columns / (2 * std::numbers::pi);
  const double rows_per_radian = options.rows / ((options.highest_deg - options.lowest_deg) * std::numbers::pi / 180.0);
  const double highest = options.highest_deg * std::numbers::pi / 180.0;
  for (const Eigen::Vector3f& point : cloud.positions) {
    const Eigen::Vector3f p = R * point + t;
    const float range = p.norm();
    if (!(range > 0.5F * static_cast<float>(size)) || range > most) continue;
    const auto flat = static_cast<double>(p.head<2>().norm());
    const double elevation = std::atan2(static_cast<double>(p.z()), flat);
    const double x =
        (std::numbers::pi - std::atan2(static_cast<double>(p.y()), static_cast<double>(p.x()))) * columns_per_radian;
    const double y = (highest - elevation) * rows_per_radian;
    const double half = 0.5 * size / static_cast<double>(range);
    const double half_x = std::min(half * static_cast<double>(range) / std::max(flat, 1e-3) * columns_per_radian,
                                   0.5 * options.columns - 1);
    const double half_y = half * rows_per_radian;
    const int top = std::max(0, static_cast<int>(std::floor(y - half_y)));
    const int bottom = std::min(options.rows - 1, static_cast<int>(std::floor(y + half_y)));
    const int left = static_cast<int>(std::floor(x - half_x)), right = static_cast<int>(std::floor(x + half_x));
    const float value = range / most;
    for (int row = top; row <= bottom; ++row)
      for (int column = left; column <= right; ++column) {
        float& pixel = image.values[image.at(row, column)];
        if (!(pixel <= value)) pixel = value;  // also where there is none
      }
  }
}

/// What several scans show of a view, pixel by pixel.
class Layers {
 public:
  explicit Layers(const PanoramaOptions& options) : options_(options), values_(Panorama(options).values.size()) {}

  /// Adds what one scan shows.
  void add(const Panorama& one) {
    for (std::size_t i = 0; i < values_.size(); ++i)
      if (!std::isnan(one.values[i])) values_[i].push_back(one.values[i]);
  }

  /// The nearest surface of each pixel: the middle of those values that make it one. Where there is none, the nearest.
  [[nodiscard]] Panorama nearest_surfaces() {
    Panorama image(options_);
    const auto depth = static_cast<float>(options_.depth_of_surface / options_.most_range);
    const std::size_t least = options_.scans_of_surface;
    for (std::size_t i = 0; i < values_.size(); ++i) {
      std::vector<float>& values = values_[i];
      if (values.empty()) continue;
      std::ranges::sort(values);
      image.values[i] = values.front();
      for (std::size_t k = 0; k + least <= values.size(); ++k)
        if (values[k + least - 1] - values[k] <= depth) {
          image.values[i] = 0.5F * (values[k + (least - 1) / 2] + values[k + least / 2]);
          break;
        }
    }
    return image;
  }

 private:
  PanoramaOptions options_;
  std::vector<std::vector<float>> values_;  ///< of each pixel, one a scan
};

/// How a rendered view differs from the scan that was taken there, over the pixels in which the scan has a return.
struct ViewErrors {
  double psnr = 0;       ///< dB: 10 log10(1 / mean squared difference), at most 100
  double loss = 0;       ///< 0.8 mean absolute difference + 0.2 (1 - SSIM), as in 3-D Gaussian splatting (Kerbl 2023)
  double uncovered = 0;  ///< share of the pixels in which the map has nothing
  std::size_t pixels = 0;
};

namespace detail {

/// Mean structural similarity (Wang et al. 2004) over the pixels that count: windows of 11 x 11 with a Gaussian of 1.5
/// pixels, K1 = 0.01, K2 = 0.03, a range of values of 1; within a window only pixels that count.
inline double similarity(const Panorama& shape, const std::vector<float>& a, const std::vector<float>& b,
                         const std::vector<bool>& counts) {
  constexpr int reach = 5;
  constexpr double c1 = 0.01 * 0.01, c2 = 0.03 * 0.03, deviation = 1.5;
  double sum = 0, pixels = 0;
  for (int row = 0; row < shape.rows; ++row)
    for (int column = 0; column < shape.columns; ++column) {
      if (!counts[shape.at(row, column)]) continue;
      double weights = 0, mean_a = 0, mean_b = 0, aa = 0, bb = 0, ab = 0;
      for (int dy = std::max(-reach, -row); dy <= std::min(reach, shape.rows - 1 - row); ++dy)
        for (int dx = -reach; dx <= reach; ++dx) {
          const std::size_t i = shape.at(row + dy, column + dx);
          if (!counts[i]) continue;
          const double weight = std::exp(-(dx * dx + dy * dy) / (2 * deviation * deviation));
          const double va = static_cast<double>(a[i]), vb = static_cast<double>(b[i]);
          weights += weight;
          mean_a += weight * va;
          mean_b += weight * vb;
          aa += weight * va * va;
          bb += weight * vb * vb;
          ab += weight * va * vb;
        }
      mean_a /= weights;
      mean_b /= weights;
      const double var_a = aa / weights - mean_a * mean_a, var_b = bb / weights - mean_b * mean_b;
      const double cov = ab / weights - mean_a * mean_b;
      sum += (2 * mean_a * mean_b + c1) * (2 * cov + c2) /
             ((mean_a * mean_a + mean_b * mean_b + c1) * (var_a + var_b + c2));
      ++pixels;
    }
  return sum / pixels;
}

}  // namespace detail

/// @param rendered  where it has nothing, it shows 1: nothing within `most_range`.
inline ViewErrors compare(const Panorama& scan, const Panorama& rendered) {
  ViewErrors errors;
  std::vector<float> shown = rendered.values;
  std::vector<bool> counts(scan.values.size());
  double squares = 0, differences = 0, uncovered = 0;
  for (std::size_t i = 0; i < scan.values.size(); ++i) {
    if (std::isnan(shown[i])) shown[i] = 1.0F;
    counts[i] = !std::isnan(scan.values[i]);
    if (!counts[i]) continue;
    const double difference = static_cast<double>(shown[i]) - static_cast<double>(scan.values[i]);
    squares += difference * difference;
    differences += std::abs(difference);
    uncovered += std::isnan(rendered.values[i]) ? 1 : 0;
    ++errors.pixels;
  }
  if (errors.pixels == 0) return errors;
  const auto pixels = static_cast<double>(errors.pixels);
  constexpr double least = 1e-10;  // 100 dB
  errors.psnr = -10 * std::log10(std::max(least, squares / pixels));
  errors.loss = 0.8 * differences / pixels + 0.2 * (1 - detail::similarity(scan, scan.values, shown, counts));
  errors.uncovered = uncovered / pixels;
  return errors;
}

}  // namespace chainslam::experiments
