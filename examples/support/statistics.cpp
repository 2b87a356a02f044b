#include "support/statistics.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace chainslam::support {

double percentile(std::vector<double> samples, double share) {
  if (samples.empty()) return 0.0;
  const double rank = std::ceil(share * static_cast<double>(samples.size()));
  const auto nth = samples.begin() + static_cast<std::ptrdiff_t>(std::max(rank, 1.0)) - 1;
  std::nth_element(samples.begin(), nth, samples.end());
  return *nth;
}

Spread spread_of(const std::vector<double>& samples) {
  if (samples.empty()) return {};
  return {percentile(samples, 0.50), percentile(samples, 0.99), *std::ranges::max_element(samples)};
}

void StageTimes::add(const std::string& stage, double seconds) {
  const std::scoped_lock lock(mutex_);
  auto entry = std::ranges::find(samples_, stage, &std::pair<std::string, std::vector<double>>::first);
  if (entry == samples_.end()) entry = samples_.insert(samples_.end(), {stage, {}});
  entry->second.push_back(seconds);
}

std::vector<StageTime> StageTimes::rows() const {
  const std::scoped_lock lock(mutex_);
  std::vector<StageTime> result;
  for (const auto& [stage, samples] : samples_) {
    const Spread spread = spread_of(samples);
    result.push_back({.stage = stage,
                      .count = to_index(samples.size(), "samples of a stage"),
                      .total = std::accumulate(samples.begin(), samples.end(), 0.0),
                      .p50 = spread.p50,
                      .p99 = spread.p99,
                      .max = spread.max});
  }
  return result;
}

}  // namespace chainslam::support
