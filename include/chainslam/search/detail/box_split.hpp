#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <limits>
#include <span>

#include "chainslam/search/detail/box_node.hpp"

namespace chainslam::detail {

/// Orders points so that the first lie below a plane across the widest side of their box, the others above. Returns how
/// many lie below: `at_least` to `at_most`, the plane being in the middle of the box where that allows it. The middle
/// keeps boxes compact where LiDAR leaves lines of points, of which a median would make slivers.
template <class Point>
[[nodiscard]] std::size_t split_points(std::span<Point> points, std::size_t at_least, std::size_t at_most) {
  Bounds<typename decltype(points[0].at)::value_type, static_cast<int>(std::tuple_size_v<decltype(points[0].at)>)> box;
  for (const Point& p : points) box.include(p.at);
  const std::size_t axis = box.widest_axis();
  const auto middle = box.low[axis] / 2 + box.high[axis] / 2;
  const auto first_above =
      std::partition(points.begin(), points.end(), [&](const Point& p) { return p.at[axis] < middle; });
  const auto below = static_cast<std::size_t>(first_above - points.begin());
  const std::size_t allowed = std::clamp(below, at_least, at_most);
  if (allowed != below)
    std::nth_element(points.begin(), points.begin() + static_cast<std::ptrdiff_t>(allowed), points.end(),
                     [axis](const Point& a, const Point& b) { return a.at[axis] < b.at[axis]; });
  return allowed;
}

/// Orders a node's children so that the first few and the others make two nodes with small margins (Beckmann et al.
/// 1990, R*-tree). Returns how many are in the first; neither gets less than a third.
template <class Entry, std::size_t Count>
[[nodiscard]] std::size_t split_entries(std::array<Entry, Count>& entries) {
  using Box = decltype(Entry::box);
  using Scalar = typename decltype(Box::low)::value_type;
  std::array<Entry, Count> best = entries;
  std::size_t best_count = Count / 2;
  Scalar best_margin = std::numeric_limits<Scalar>::infinity();
  for (std::size_t axis = 0; axis < std::tuple_size_v<decltype(Box::low)>; ++axis) {
    std::sort(entries.begin(), entries.end(), [axis](const Entry& a, const Entry& b) {
      return a.box.low[axis] / 2 + a.box.high[axis] / 2 < b.box.low[axis] / 2 + b.box.high[axis] / 2;
    });
    for (std::size_t count = Count / 3; count <= Count - Count / 3; ++count) {
      Box first, second;
      for (std::size_t i = 0; i < Count; ++i) (i < count ? first : second).include(entries[i].box);
      const Scalar margin = first.margin() + second.margin();
      if (!(margin < best_margin)) continue;
      best_margin = margin;
      best_count = count;
      best = entries;
    }
  }
  entries = best;
  return best_count;
}

}  // namespace chainslam::detail
