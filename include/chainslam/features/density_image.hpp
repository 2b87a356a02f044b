#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <vector>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/core/finite.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam {

struct DensityImageOptions {
  double cell_size = 0.5;    ///< metres, of a pixel's side
  double bin_height = 0.25;  ///< metres
  double max_range = 60.0;   ///< metres from the origin along x and y: points farther away are not drawn
  Index max_bins = 16;       ///< a pixel with so many occupied bins or more is white
};

/// A cloud seen from above: how much of the height above each cell of a level grid is occupied.
///
/// A pixel counts the occupied height bins, not the points: walls, trunks and poles are bright, the ground is almost
/// black, and neither the distance to the sensor nor the number of scans that saw a surface changes it, as they change
/// a count of points (Gupta et al. 2024, "Effectively Detecting Loop Closures using Point Cloud Density Maps").
struct DensityImage {
  Index width = 0;   ///< pixels along x
  Index height = 0;  ///< pixels along y
  double cell_size = 0;
  Eigen::Vector2d corner = Eigen::Vector2d::Zero();  ///< of pixel (0, 0), metres
  std::vector<float> values;                         ///< rows of equal y; 0 to 1
  std::vector<float> lowest;                         ///< of the points above a pixel, metres; infinity: none

  [[nodiscard]] bool contains(Index x, Index y) const { return x >= 0 && y >= 0 && x < width && y < height; }
  [[nodiscard]] std::size_t at(Index x, Index y) const {
    return static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x);
  }
  /// Zero outside of the image.
  [[nodiscard]] float value(Index x, Index y) const { return contains(x, y) ? values[at(x, y)] : 0.0F; }
  /// Of a point in pixels, whose whole numbers are the pixels' centres, in metres.
  [[nodiscard]] Eigen::Vector2d position(const Eigen::Vector2d& pixel) const {
    return corner + cell_size * (pixel + Eigen::Vector2d::Constant(0.5));
  }
};

namespace detail {

[[gnu::cold]] inline void check(const DensityImageOptions& options) {
  if (!(options.cell_size > 0 && options.bin_height > 0 && options.max_range > 0) || options.max_bins < 2)
    throw std::invalid_argument(
        "DensityImageOptions: cell_size, bin_height and max_range must be positive, max_bins 2 or more");
  if (!(options.max_range / options.cell_size < 4096.0))
    throw std::invalid_argument("DensityImageOptions: max_range must be below 4096 cells");
}

}  // namespace detail

/// Draws a cloud.
/// @param cloud  metres, z against gravity; points that are not finite are skipped.
/// @returns an image that just holds the points within range; without any, one of no pixels.
/// @throws std::invalid_argument if an option makes no sense.
template <Cloud C>
[[nodiscard]] DensityImage density_image(const C& cloud, const DensityImageOptions& options = {}) {
  detail::check(options);
  const auto cells = static_cast<Index>(std::ceil(options.max_range / options.cell_size));
  const auto cell = [&](double metres) { return static_cast<Index>(std::floor(metres / options.cell_size)); };
  const auto for_each_in_range = [&](auto&& visit) {
    for (std::size_t i = 0; i < CloudTraits<C>::size(cloud); ++i) {
      const Eigen::Vector3d p = CloudTraits<C>::position(cloud, i).template cast<double>();
      if (!is_finite(p) || !(p.head<2>().cwiseAbs().maxCoeff() < options.max_range) || !(std::abs(p.z()) < 1e6))
        continue;
      visit(cell(p.x()), cell(p.y()), p.z());
    }
  };
  Index low_x = cells, low_y = cells, high_x = -cells - 1, high_y = -cells - 1;
  for_each_in_range([&](Index x, Index y, double) {
    low_x = std::min(low_x, x), low_y = std::min(low_y, y), high_x = std::max(high_x, x), high_y = std::max(high_y, y);
  });
  DensityImage image{.cell_size = options.cell_size};
  if (high_x < low_x) return image;
  image.width = high_x - low_x + 1;
  image.height = high_y - low_y + 1;
  image.corner = options.cell_size * Eigen::Vector2d(low_x, low_y);
  const std::size_t pixels = static_cast<std::size_t>(image.width) * static_cast<std::size_t>(image.height);
  image.values.assign(pixels, 0.0F);
  image.lowest.assign(pixels, std::numeric_limits<float>::infinity());
  std::vector<std::uint64_t> bins(pixels, 0);  // heights modulo 64 bins: no level of the ground is needed
  for_each_in_range([&](Index x, Index y, double z) {
    const std::size_t pixel = image.at(x - low_x, y - low_y);
    const auto bin = static_cast<std::int64_t>(std::floor(z / options.bin_height));
    bins[pixel] |= std::uint64_t{1} << (static_cast<std::uint64_t>(bin) & 63U);
    image.lowest[pixel] = std::min(image.lowest[pixel], static_cast<float>(z));
  });
  for (std::size_t pixel = 0; pixel < pixels; ++pixel)
    image.values[pixel] = static_cast<float>(std::min<int>(std::popcount(bins[pixel]), options.max_bins)) /
                          static_cast<float>(options.max_bins);
  return image;
}

}  // namespace chainslam
