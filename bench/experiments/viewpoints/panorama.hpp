#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <iterator>
#include <limits>
#include <numbers>
#include <optional>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/types.hpp"
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
  double full_share = 0.99;  ///< the value 1 of intensities is what so many of a scan's pixels do not exceed
};

/// Numbers row by row; NaN where there is nothing.
struct Image {
  int columns = 0, rows = 0;
  std::vector<float> values;

  explicit Image(const PanoramaOptions& options)
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

/// What is seen of a place's surroundings, pixel by pixel.
struct Panorama {
  Image ranges;       ///< from 0 (here) to 1 (`most_range` and more)
  Image intensities;  ///< of the points that are seen, on the sensor's own scale; NaN if the cloud has none

  explicit Panorama(const PanoramaOptions& options) : ranges(options), intensities(options) {}
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
  const bool has_intensities = cloud.has_intensities();
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    const Eigen::Vector3f p = R * cloud.positions[i] + t;
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
    const float intensity = has_intensities ? cloud.intensities[i] : std::numeric_limits<float>::quiet_NaN();
    for (int row = top; row <= bottom; ++row)
      for (int column = left; column <= right; ++column) {
        const std::size_t pixel = image.ranges.at(row, column);
        if (image.ranges.values[pixel] <= value) continue;  // not so where there is none
        image.ranges.values[pixel] = value;
        image.intensities.values[pixel] = intensity;
      }
  }
}

/// What several scans show of a view, pixel by pixel.
class Layers {
 public:
  explicit Layers(const PanoramaOptions& options) : options_(options), seen_(Image(options).values.size()) {}

  /// Adds what one scan shows.
  void add(const Panorama& one) {
    for (std::size_t i = 0; i < seen_.size(); ++i)
      if (!std::isnan(one.ranges.values[i])) seen_[i].push_back({one.ranges.values[i], one.intensities.values[i]});
  }

  /// The nearest surface of each pixel: the middle of those ranges that make it one, and the intensity that the same
  /// scans have there. Where there is none, the nearest.
  [[nodiscard]] Panorama nearest_surfaces() {
    Panorama image(options_);
    const auto depth = static_cast<float>(options_.depth_of_surface / options_.most_range);
    const std::size_t least = options_.scans_of_surface;
    for (std::size_t i = 0; i < seen_.size(); ++i) {
      std::vector<Point>& seen = seen_[i];
      if (seen.empty()) continue;
      std::ranges::sort(seen, {}, &Point::range);
      Point a = seen.front(), b = a;
      for (std::size_t k = 0; k + least <= seen.size(); ++k)
        if (seen[k + least - 1].range - seen[k].range <= depth) {
          a = seen[k + (least - 1) / 2], b = seen[k + least / 2];
          break;
        }
      image.ranges.values[i] = 0.5F * (a.range + b.range);
      image.intensities.values[i] = 0.5F * (a.intensity + b.intensity);
    }
    return image;
  }

 private:
  struct Point {
    float range, intensity;
  };

  PanoramaOptions options_;
  std::vector<std::vector<Point>> seen_;  ///< of each pixel, one a scan
};

/// The intensity that becomes the value 1, by the scan that was taken at a view; nothing if no pixel has any.
inline std::optional<float> full_intensity(const Image& scan, const PanoramaOptions& options) {
  std::vector<float> seen;
  std::ranges::copy_if(scan.values, std::back_inserter(seen), [](float value) { return is_finite(value); });
  if (seen.empty()) return std::nullopt;
  const auto rank = static_cast<std::ptrdiff_t>(std::ceil(options.full_share * static_cast<double>(seen.size())));
  const auto full = seen.begin() + rank - 1;
  std::ranges::nth_element(seen, full);
  return *full > 0 ? std::optional(*full) : std::nullopt;
}

/// Intensities as values from 0 to 1.
inline Image scaled(Image intensities, float full) {
  for (float& value : intensities.values) value = std::clamp(value / full, 0.0F, 1.0F);  // NaN stays
  return intensities;
}

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
inline double similarity(const Image& shape, const std::vector<float>& a, const std::vector<float>& b,
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

/// @param nothing  shown where nothing is rendered: 1 of ranges, nothing within `most_range`; 0 of intensities, no
/// light.
inline ViewErrors compare(const Image& scan, const Image& rendered, float nothing) {
  ViewErrors errors;
  std::vector<float> shown = rendered.values;
  std::vector<bool> counts(scan.values.size());
  double squares = 0, differences = 0, uncovered = 0;
  for (std::size_t i = 0; i < scan.values.size(); ++i) {
    if (std::isnan(shown[i])) shown[i] = nothing;
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
