#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace chainslam::bench {

/// Bounds of a share, in [0, 1].
struct ShareBounds {
  double low = 0, high = 1;
};

/// The bounds between which the true share lies with 95 %, if `hits` of `trials` came out (Wilson 1927).
[[nodiscard]] inline ShareBounds wilson(std::size_t hits, std::size_t trials) {
  if (trials == 0) return {};
  constexpr double z = 1.96;
  const auto n = static_cast<double>(trials);
  const double p = static_cast<double>(hits) / n, scale = 1 + z * z / n, middle = (p + z * z / (2 * n)) / scale;
  const double half = z / scale * std::sqrt(p * (1 - p) / n + z * z / (4 * n * n));
  return {std::max(0.0, middle - half), std::min(1.0, middle + half)};
}

/// What the true share is below with 95 %: 3 over the trials if none came out (the rule of three).
[[nodiscard]] inline double largest_share(std::size_t hits, std::size_t trials) {
  if (trials == 0) return 1;
  return hits == 0 ? std::min(1.0, 3.0 / static_cast<double>(trials)) : wilson(hits, trials).high;
}

}  // namespace chainslam::bench
