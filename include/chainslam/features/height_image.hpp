#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <stdexcept>
#include <vector>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/core/finite.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam {

/// How a height image is drawn.
struct HeightImageOptions {
  double cell_size = 0.5;    ///< metres, of a pixel's side
  double max_range = 100.0;  ///< metres from the origin along x and y: points farther away are not drawn
  double white = 4.0;        ///< metres: a pixel whose points span as much height or more is white
};

/// A cloud seen from above: how tall what stands on each cell of a level grid is.
///
/// A pixel is the height that its points span. Walls, trunks and poles are bright and the ground is almost black
/// wherever it lies. Unlike a count of points (Gupta et al. 2024, "Effectively Detecting Loop Closures using Point
/// Cloud Density Maps") it changes neither with the distance to the sensor nor with the number of scans: two points are
/// enough to show a wall.
struct HeightImage {
  Index width = 0;                                   ///< pixels along x
  Index height = 0;                                  ///< pixels along y
  double cell_size = 0;                              ///< metres, of a pixel's side
  Eigen::Vector2d corner = Eigen::Vector2d::Zero();  ///< of pixel (0, 0), metres
  std::vector<float> values;                         ///< rows of equal y; 0 to 1

  /// Whether there is such a pixel.
  [[nodiscard]] bool contains(Index x, Index y) const { return x >= 0 && y >= 0 && x < width && y < height; }
  /// Where a pixel is in `values`.
  [[nodiscard]] std::size_t at(Index x, Index y) const {
    return static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x);
  }
  /// @param pixel  whole numbers are centres of pixels.
  /// @returns metres, in the frame of the cloud.
  [[nodiscard]] Eigen::Vector2d position(const Eigen::Vector2d& pixel) const {
    return corner + cell_size * (pixel + Eigen::Vector2d::Constant(0.5));
  }
};

namespace detail {

[[gnu::cold]] inline void check(const HeightImageOptions& options) {
  if (!(options.cell_size > 0 && options.max_range > 0 && options.white > 0))
    throw std::invalid_argument("HeightImageOptions: cell_size, max_range and white must be positive");
  if (!(options.max_range / options.cell_size <= 4096.0))
    throw std::invalid_argument("HeightImageOptions: max_range must be 4096 cells at most");
}

}  // namespace detail

/// Draws a cloud.
/// @param cloud  metres, z against gravity; points that are not finite are skipped.
/// @returns the smallest image that holds the points within range; without any, one of no pixels.
/// @throws std::invalid_argument if an option makes no sense.
template <Cloud C>
[[nodiscard]] HeightImage height_image(const C& cloud, const HeightImageOptions& options = {}) {
  detail::check(options);
  const auto for_each_in_range = [&](auto&& visit) {
    for (std::size_t i = 0; i < cloud_size(cloud); ++i) {
      const Eigen::Vector3d p = position(cloud, i);
      if (is_finite(p) && std::max(std::abs(p.x()), std::abs(p.y())) < options.max_range)
        visit(static_cast<Index>(std::floor(p.x() / options.cell_size)),
              static_cast<Index>(std::floor(p.y() / options.cell_size)), static_cast<float>(p.z()));
    }
  };
  constexpr Index none = std::numeric_limits<Index>::max();
  Index low_x = none, low_y = none, high_x = -none, high_y = -none;
  for_each_in_range([&](Index x, Index y, float) {
    low_x = std::min(low_x, x), low_y = std::min(low_y, y), high_x = std::max(high_x, x), high_y = std::max(high_y, y);
  });
  HeightImage image;
  image.cell_size = options.cell_size;
  if (low_x == none) return image;
  image.width = high_x - low_x + 1;
  image.height = high_y - low_y + 1;
  image.corner = options.cell_size * Eigen::Vector2d(low_x, low_y);
  const std::size_t pixels = static_cast<std::size_t>(image.width) * static_cast<std::size_t>(image.height);
  std::vector<float> lowest(pixels, std::numeric_limits<float>::infinity());
  std::vector<float> highest(pixels, -std::numeric_limits<float>::infinity());
  for_each_in_range([&](Index x, Index y, float z) {
    const std::size_t pixel = image.at(x - low_x, y - low_y);
    lowest[pixel] = std::min(lowest[pixel], z);
    highest[pixel] = std::max(highest[pixel], z);
  });
  image.values.resize(pixels);
  const auto white = static_cast<float>(options.white);
  for (std::size_t pixel = 0; pixel < pixels; ++pixel)
    image.values[pixel] = std::clamp((highest[pixel] - lowest[pixel]) / white, 0.0F, 1.0F);  // -inf: none
  return image;
}

}  // namespace chainslam
