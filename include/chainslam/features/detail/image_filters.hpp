#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
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
  [[nodiscard]] float& operator()(Index x, Index y) { return values[at(x, y)]; }
  [[nodiscard]] float value(Index x, Index y) const {
    return x >= 0 && y >= 0 && x < width && y < height ? values[at(x, y)] : 0.0F;
  }
  /// Bilinear between the pixels' centres.
  [[nodiscard]] float interpolated(float x, float y) const {
    const float left = std::floor(x), top = std::floor(y);
    const auto i = static_cast<Index>(left), j = static_cast<Index>(top);
    const float u = x - left, v = y - top;
    return (1 - v) * ((1 - u) * value(i, j) + u * value(i + 1, j)) +
           v * ((1 - u) * value(i, j + 1) + u * value(i + 1, j + 1));
  }
};

/// By a Gaussian of so many pixels' deviation, cut off at three of them.
[[nodiscard]] inline GrayImage blurred(const GrayImage& image, double deviation) {
  const auto reach = static_cast<Index>(std::ceil(3 * deviation));
  std::vector<float> weights;
  float sum = 0;
  for (Index k = -reach; k <= reach; ++k) {
    weights.push_back(static_cast<float>(std::exp(-0.5 * k * k / (deviation * deviation))));
    sum += weights.back();
  }
  for (float& weight : weights) weight /= sum;
  GrayImage along{image.width, image.height, std::vector<float>(image.values.size(), 0.0F)};
  GrayImage result = along;
  for (Index y = 0; y < image.height; ++y)
    for (Index k = -reach; k <= reach; ++k) {
      const float weight = weights[static_cast<std::size_t>(k + reach)];
      const Index begin = std::max(0, -k), end = std::min(image.width, image.width - k);
      const float* const from = image.values.data() + image.at(0, y);
      float* const to = along.values.data() + image.at(0, y);
      for (Index x = begin; x < end; ++x) to[x] += weight * from[x + k];
    }
  for (Index y = 0; y < image.height; ++y)
    for (Index k = std::max(-reach, -y); k <= reach && y + k < image.height; ++k) {
      const float weight = weights[static_cast<std::size_t>(k + reach)];
      const float* const from = along.values.data() + image.at(0, y + k);
      float* const to = result.values.data() + image.at(0, y);
      for (Index x = 0; x < image.width; ++x) to[x] += weight * from[x];
    }
  return result;
}

}  // namespace chainslam::detail
