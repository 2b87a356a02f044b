#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <unordered_map>
#include <vector>

#include "simulator/plot.hpp"

namespace chainslam::simulator {

/// Plots that are taken, found by place.
class TakenPlots {
 public:
  [[nodiscard]] bool is_free(const Plot& plot) const {
    bool free = true;
    for_each_cell(plot, [&](std::int64_t cell) {
      if (const auto found = cells_.find(cell); found != cells_.end())
        for (const std::size_t i : found->second) free = free && !overlap(plot, plots_[i]);
    });
    return free;
  }
  void take(const Plot& plot) {
    for_each_cell(plot, [&](std::int64_t cell) { cells_[cell].push_back(plots_.size()); });
    plots_.push_back(plot);
  }

 private:
  template <class Visit>
  static void for_each_cell(const Plot& plot, const Visit& visit) {
    constexpr double size = 16.0;  // metres
    const auto index = [](double value) { return static_cast<std::int64_t>(std::floor(value / size)); };
    const double reach = plot.radius();
    for (std::int64_t y = index(plot.center.y() - reach); y <= index(plot.center.y() + reach); ++y)
      for (std::int64_t x = index(plot.center.x() - reach); x <= index(plot.center.x() + reach); ++x)
        visit((y << 32) + x);
  }

  std::vector<Plot> plots_;
  std::unordered_map<std::int64_t, std::vector<std::size_t>> cells_;
};

}  // namespace chainslam::simulator
