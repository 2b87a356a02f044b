#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <span>
#include <vector>

#include "chainslam/core/types.hpp"

namespace chainslam::detail {

/// Rows of pixels; black outside.
struct GrayImage {
  Index width = 0;
  Index height = 0;
  std::vector<float> values;

  [[nodiscard]] std::size_t at(Index x, Index y) const {
    return static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x);
  }
  [[nodiscard]] float value(Index x, Index y) const {
    return x >= 0 && y >= 0 && x < width && y < height ? values[at(x, y)] : 0.0F;
  }
  /// Bilinear between the pixels' centres, of which all four are in the image.
  [[nodiscard]] float interpolated(float x, float y) const {
    const auto i = static_cast<Index>(x), j = static_cast<Index>(y);
    const float u = x - static_cast<float>(i), v = y - static_cast<float>(j);
    const float* const upper = values.data() + at(i, j);
    const float* const lower = upper + width;
    return (1 - v) * ((1 - u) * upper[0] + u * upper[1]) + v * ((1 - u) * lower[0] + u * lower[1]);
  }
};

/// With a black frame, so many pixels wide.
[[nodiscard]] inline GrayImage framed(const GrayImage& image, Index margin) {
  GrayImage result{image.width + 2 * margin, image.height + 2 * margin, {}};
  result.values.resize(result.at(0, result.height), 0.0F);
  for (Index y = 0; y < image.height; ++y)
    std::copy_n(image.values.data() + image.at(0, y), image.width,
                result.values.data() + result.at(margin, y + margin));
  return result;
}

/// Columns that are summed at a time, in registers.
inline constexpr Index blur_block = 16;

/// Row of sums of rows, or of shifted values of one row: to[x] = sum of weights[k] from[x + k step], x below `width`.
/// `from` and what lies a step apart have values up to the next multiple of the block.
inline void weighted_sums(const float* from, std::size_t step, std::span<const float> weights, Index width, float* to) {
  using Block = Eigen::Array<float, blur_block, 1>;
  for (Index x = 0; x < width; x += blur_block) {
    Block sums = Block::Zero();
    const float* values = from + x;
    for (const float weight : weights) {
      sums += weight * Eigen::Map<const Block>(values);
      values += step;
    }
    std::copy_n(sums.data(), std::min(blur_block, width - x), to + x);
  }
}

/// By a Gaussian of so many pixels' deviation, cut off at three of them.
inline void blur(GrayImage& image, double deviation) {
  const auto reach = static_cast<Index>(std::ceil(3 * deviation));
  std::vector<float> weights;
  float sum = 0;
  for (Index k = -reach; k <= reach; ++k) {
    weights.push_back(static_cast<float>(std::exp(-0.5 * k * k / (deviation * deviation))));
    sum += weights.back();
  }
  for (float& weight : weights) weight /= sum;
  const auto stride = static_cast<std::size_t>((image.width + blur_block - 1) / blur_block * blur_block);
  const auto margin = static_cast<std::size_t>(reach);
  std::vector<float> row(stride + 2 * margin, 0.0F);  // black on both sides
  std::vector<float> along(stride * static_cast<std::size_t>(image.height), 0.0F);
  for (Index y = 0; y < image.height; ++y) {
    std::copy_n(image.values.data() + image.at(0, y), image.width, row.data() + margin);
    weighted_sums(row.data(), 1, weights, image.width, along.data() + static_cast<std::size_t>(y) * stride);
  }
  for (Index y = 0; y < image.height; ++y) {
    const Index top = std::max(0, y - reach), bottom = std::min(image.height - 1, y + reach);
    const auto rows = std::span(weights).subspan(static_cast<std::size_t>(top - y + reach),
                                                 static_cast<std::size_t>(bottom - top + 1));
    weighted_sums(along.data() + static_cast<std::size_t>(top) * stride, stride, rows, image.width,
                  image.values.data() + image.at(0, y));
  }
}

}  // namespace chainslam::detail
