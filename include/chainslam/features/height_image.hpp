#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <vector>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/core/random.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/features/detail/image_filters.hpp"
#include "chainslam/search/hamming_forest.hpp"

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

/// A corner of a height image.
struct ImageKeypoint {
  Eigen::Vector2f position{0, 0};  ///< metres, in the frame of the image's cloud
  float angle = 0;                 ///< radians, of the direction in which its surroundings are brighter
  BinaryDescriptor descriptor{};   ///< of its surroundings, turned to its orientation
};

/// Which corners are found, and how they are described.
struct ImageKeypointOptions {
  double smoothing = 1.0;      ///< pixels: deviation of the Gaussian by which corners are sought
  double window = 1.5;         ///< pixels: deviation of the Gaussian that weights gradients around a corner
  double min_response = 1e-4;  ///< the structure tensor's smaller eigenvalue, of an image from 0 to 1
  Index separation = 3;        ///< pixels to the next stronger corner, at least
  Index max_count = 200;       ///< the strongest
  double radius = 20.0;        ///< pixels, of the disc that a descriptor compares
  double spread = 1.5;         ///< pixels: deviation of the Gaussian over which a compared value is averaged
};

namespace detail {

[[gnu::cold]] inline void check(const ImageKeypointOptions& options) {
  if (!(options.smoothing > 0 && options.window > 0 && options.radius >= 2 && options.spread > 0) ||
      options.separation < 1 || options.max_count < 0)
    throw std::invalid_argument(
        "ImageKeypointOptions: smoothing, window and spread must be positive, radius 2 or more, separation 1 or more");
}

/// Pairs of places in the unit disc that a descriptor compares: normally distributed (Calonder et al. 2010, BRIEF,
/// pattern G II), the same in every program.
struct ComparisonPattern {
  std::array<std::array<Eigen::Vector2f, 2>, 256> pairs;

  ComparisonPattern() {
    Rng rng(1);
    const auto place = [&] {
      for (;;) {
        const Eigen::Vector2d p(rng.normal(0, 0.4), rng.normal(0, 0.4));
        if (p.squaredNorm() <= 1) return p;
      }
    };
    for (auto& pair : pairs) {
      do {
        pair[0] = place().cast<float>();
        pair[1] = place().cast<float>();
      } while ((pair[0] - pair[1]).norm() < 0.2F);
    }
  }
  [[nodiscard]] static const ComparisonPattern& instance() {
    static const ComparisonPattern pattern;
    return pattern;
  }
};

/// The smaller eigenvalue of the structure tensor at each pixel (Shi and Tomasi 1994).
[[nodiscard]] inline GrayImage corner_response(const GrayImage& smooth, double window) {
  using Row = Eigen::Map<Eigen::ArrayXf>;
  using ConstRow = Eigen::Map<const Eigen::ArrayXf>;
  const GrayImage around = framed(smooth, 1);
  GrayImage xx{smooth.width, smooth.height, std::vector<float>(smooth.values.size())}, xy = xx, yy = xx;
  const auto row_of = [&](GrayImage& image, Index y) { return Row(image.values.data() + image.at(0, y), image.width); };
  for (Index y = 0; y < smooth.height; ++y) {
    const float* const center = around.values.data() + around.at(1, y + 1);
    const auto shifted = [&](Index by) { return ConstRow(center + by, smooth.width); };
    const Eigen::ArrayXf dx = 0.5F * (shifted(1) - shifted(-1));
    const Eigen::ArrayXf dy = 0.5F * (shifted(around.width) - shifted(-around.width));
    row_of(xx, y) = dx * dx, row_of(xy, y) = dx * dy, row_of(yy, y) = dy * dy;
  }
  for (GrayImage* image : {&xx, &xy, &yy}) blur(*image, window);
  for (std::size_t i = 0; i < xx.values.size(); ++i) {
    const float mean = 0.5F * (xx.values[i] + yy.values[i]), half = 0.5F * (xx.values[i] - yy.values[i]);
    xx.values[i] = mean - std::sqrt(half * half + xy.values[i] * xy.values[i]);
  }
  return xx;
}

/// Where between the pixels the response is largest: the vertex of the parabolas through the neighbours' values.
[[nodiscard]] inline Eigen::Vector2d vertex(const GrayImage& response, const Eigen::Vector2i& corner) {
  const auto offset = [&](Index dx, Index dy) {
    const auto value = [&](Index step) {
      return static_cast<double>(response.value(corner.x() + step * dx, corner.y() + step * dy));
    };
    const double curvature = value(-1) - 2 * value(0) + value(1);
    return curvature < 0 ? std::clamp(0.5 * (value(-1) - value(1)) / curvature, -0.5, 0.5) : 0.0;
  };
  return corner.cast<double>() + Eigen::Vector2d(offset(1, 0), offset(0, 1));
}

/// The strongest corners, each the strongest within the separation.
[[nodiscard]] inline std::vector<Eigen::Vector2i> corners(const GrayImage& response,
                                                          const ImageKeypointOptions& options) {
  const auto least = static_cast<float>(options.min_response);
  const auto is_strongest = [&](Index x, Index y) {
    const float here = response.value(x, y);
    for (Index dy = -options.separation; dy <= options.separation; ++dy)
      for (Index dx = -options.separation; dx <= options.separation; ++dx) {
        const float there = response.value(x + dx, y + dy);
        if (there > here || (there == here && (dy < 0 || (dy == 0 && dx < 0)))) return false;
      }
    return true;
  };
  Table<Ranked> found;
  for (Index y = 0; y < response.height; ++y)
    for (Index x = 0; x < response.width; ++x)
      if (response.value(x, y) >= least && is_strongest(x, y))
        found.push_back({-static_cast<double>(response.value(x, y)), y * response.width + x});
  sort_ranked(found.all());
  std::vector<Eigen::Vector2i> strongest;
  for (const Ranked& one : found.all()) {
    if (to_index(strongest.size()) >= options.max_count) break;
    strongest.emplace_back(one.index % response.width, one.index / response.width);
  }
  return strongest;
}

/// Of the centroid of a disc (Rosin 1999, as in ORB: Rublee et al. 2011), which lies in the image.
[[nodiscard]] inline float orientation(const GrayImage& image, const Eigen::Vector2i& center, double radius) {
  const auto reach = static_cast<Index>(radius);
  float x_moment = 0, y_moment = 0;
  for (Index dy = -reach; dy <= reach; ++dy) {
    const float* const row = image.values.data() + image.at(center.x(), center.y() + dy);
    const auto half = static_cast<Index>(std::sqrt(radius * radius - static_cast<double>(dy) * dy));
    for (Index dx = -half; dx <= half; ++dx) {
      x_moment += static_cast<float>(dx) * row[dx];
      y_moment += static_cast<float>(dy) * row[dx];
    }
  }
  return std::atan2(y_moment, x_moment);
}

/// @param image  holds the disc and two pixels around it.
[[nodiscard]] inline BinaryDescriptor described(const GrayImage& image, const Eigen::Vector2i& center, float angle,
                                                double radius) {
  const Eigen::Vector2f along = static_cast<float>(radius) * Eigen::Vector2f(std::cos(angle), std::sin(angle));
  const Eigen::Vector2f across(-along.y(), along.x());
  const auto sample = [&](const Eigen::Vector2f& p) {
    const Eigen::Vector2f at = p.x() * along + p.y() * across;
    return image.interpolated(static_cast<float>(center.x()) + at.x(), static_cast<float>(center.y()) + at.y());
  };
  BinaryDescriptor descriptor{};
  const auto& pairs = ComparisonPattern::instance().pairs;
  for (std::size_t bit = 0; bit < pairs.size(); ++bit)
    if (sample(pairs[bit][0]) < sample(pairs[bit][1])) descriptor[bit / 64] |= std::uint64_t{1} << (bit % 64);
  return descriptor;
}

}  // namespace detail

/// Corners of a height image with binary descriptors that turn with them, the strongest first.
/// @throws std::invalid_argument if an option makes no sense.
[[nodiscard]] inline std::vector<ImageKeypoint> image_keypoints(const HeightImage& image,
                                                                const ImageKeypointOptions& options = {}) {
  detail::check(options);
  std::vector<ImageKeypoint> keypoints;
  if (image.values.empty()) return keypoints;
  detail::GrayImage smooth{image.width, image.height, image.values};
  detail::blur(smooth, options.smoothing);
  const detail::GrayImage response = detail::corner_response(smooth, options.window);
  const auto margin = static_cast<Index>(options.radius) + 2;
  const detail::GrayImage oriented = detail::framed(smooth, margin);
  detail::GrayImage averaged{image.width, image.height, image.values};
  detail::blur(averaged, options.spread);
  averaged = detail::framed(averaged, margin);
  for (const Eigen::Vector2i& corner : detail::corners(response, options)) {
    ImageKeypoint keypoint;
    keypoint.position = image.position(detail::vertex(response, corner)).cast<float>();
    const Eigen::Vector2i center = corner + Eigen::Vector2i::Constant(margin);
    keypoint.angle = detail::orientation(oriented, center, options.radius);
    keypoint.descriptor = detail::described(averaged, center, keypoint.angle, options.radius);
    keypoints.push_back(keypoint);
  }
  return keypoints;
}

}  // namespace chainslam
