#pragma once

#include <algorithm>
#include <cmath>
#include <optional>
#include <span>
#include <vector>

#include "chainslam/core/types.hpp"

namespace chainslam {

/// What evo states of a list of errors, in the errors' unit (`sse` in its square).
struct ErrorStatistics {
  Index count = 0;    ///< how many errors
  double rmse = 0;    ///< root of the mean square
  double mean = 0;    ///< arithmetic mean
  double median = 0;  ///< mean of the two middle ones of an even number
  double std = 0;     ///< of the population, as numpy's default
  double min = 0;     ///< smallest
  double max = 0;     ///< largest
  double sse = 0;     ///< sum of squares
};

/// Statistics of errors that are finite; nothing if there are none.
[[nodiscard]] inline std::optional<ErrorStatistics> error_statistics(std::span<const double> errors) {
  if (errors.empty()) return std::nullopt;
  ErrorStatistics result;
  result.count = to_index(errors.size(), "errors");
  const double count = static_cast<double>(errors.size());
  for (const double error : errors) {
    result.mean += error / count;
    result.sse += error * error;
  }
  double variance = 0;
  for (const double error : errors) variance += (error - result.mean) * (error - result.mean) / count;
  result.std = std::sqrt(variance);
  result.rmse = std::sqrt(result.sse / count);

  std::vector<double> sorted(errors.begin(), errors.end());
  std::sort(sorted.begin(), sorted.end());
  result.min = sorted.front();
  result.max = sorted.back();
  const std::size_t middle = sorted.size() / 2;
  result.median = sorted.size() % 2 == 1 ? sorted[middle] : 0.5 * (sorted[middle - 1] + sorted[middle]);
  return result;
}

}  // namespace chainslam
