#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <limits>
#include <span>

#include "chainslam/search/detail/box_node.hpp"

namespace chainslam::detail {

/// Moves the points for which `below(p)` holds to the front, where they keep their order, without a branch: no
/// processor could guess it. Returns how many there are.
template <class Point, class Below>
std::size_t part_points(std::span<Point> points, Below&& below) {
  std::size_t count = 0;
  for (Point& here : points) {
    const Point p = here;
    here = points[count];
    points[count] = p;
    count += below(p) ? 1 : 0;
  }
  return count;
}

/// A plane across an axis, and how many points lie below it; those at it may lie on either side.
template <class Scalar>
struct PointSplit {
  std::size_t axis;
  Scalar at;
  std::size_t below;
};

/// Orders points so that the first lie below a plane across the widest side of their box, the others above: `at_least`
/// to `at_most` below, the plane being in the middle of the box where that allows it. The middle keeps boxes compact
/// where LiDAR leaves lines of points, of which a median would make slivers.
template <class Point, class Scalar = typename decltype(Point::at)::value_type>
[[nodiscard]] PointSplit<Scalar> split_points(std::span<Point> points, std::size_t at_least, std::size_t at_most) {
  Bounds<Scalar, static_cast<int>(std::tuple_size_v<decltype(Point::at)>)> box;
  for (const Point& p : points) box.include(p.at);
  const std::size_t axis = box.widest_axis();
  const Scalar middle = box.low[axis] / 2 + box.high[axis] / 2;
  const std::size_t below = part_points(points, [&](const Point& p) { return p.at[axis] < middle; });
  const std::size_t allowed = std::clamp(below, at_least, at_most);
  if (allowed == below) return {axis, middle, below};
  std::nth_element(points.begin(), points.begin() + static_cast<std::ptrdiff_t>(allowed), points.end(),
                   [axis](const Point& a, const Point& b) { return a.at[axis] < b.at[axis]; });
  return {axis, points[allowed].at[axis], allowed};
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
