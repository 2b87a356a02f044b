#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstring>
#include <limits>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/search/detail/box_node.hpp"

namespace chainslam::detail {

/// Moves the points below a plane across an axis to the front, the others behind them, both in their order, without a
/// branch: no processor could guess it. Returns how many are in front. `scratch` is as long as `points`, or longer.
template <class Point, class Scalar>
std::size_t part_points(std::span<Point> points, std::span<Point> scratch, std::size_t axis, Scalar at) {
  Point* const begin = points.data();
  Point* front = begin;
  Point* behind = scratch.data();  // by how many are in front too far
  for (const Point& here : points) {
    const bool in_front = here.at[axis] < at;
    alignas(Point) std::array<std::byte, sizeof(Point)> whole;  // what lies between members, too: one register at once
    std::memcpy(whole.data(), &here, sizeof(Point));
    std::memcpy(static_cast<void*>(front), whole.data(), sizeof(Point));
    std::memcpy(static_cast<void*>(behind - (front - begin)), whole.data(), sizeof(Point));
    front += in_front ? 1 : 0;
    ++behind;
  }
  std::copy(scratch.data(), behind - (front - begin), front);
  return static_cast<std::size_t>(front - begin);
}

/// The tight box of points.
template <class Point, class Scalar = typename decltype(Point::at)::value_type>
[[nodiscard]] auto box_of_points(std::span<Point> points) {
  constexpr std::size_t dim = std::tuple_size_v<decltype(Point::at)>;
  Bounds<Scalar, static_cast<int>(dim)> box;
  if constexpr (sizeof(Point) == 16 && sizeof(Scalar) == 4 && dim == 3) {
    // What lies behind the coordinates is compared along with them, to be left out in the end: one register a point.
    typedef float Four __attribute__((vector_size(4 * sizeof(float))));
    constexpr std::size_t at_once = 4;  // as one comparison waits for the one before
    std::array<Four, at_once> low, high;
    low.fill(Four{} + std::numeric_limits<float>::infinity());
    high.fill(Four{} - std::numeric_limits<float>::infinity());
    const auto include = [&](const Point& point, std::size_t i) {
      Four p;
      std::memcpy(&p, &point, sizeof(p));
      low[i] = p < low[i] ? p : low[i];
      high[i] = p > high[i] ? p : high[i];
    };
    const std::size_t whole = points.size() - points.size() % at_once;
    for (std::size_t begin = 0; begin < whole; begin += at_once)
      for (std::size_t i = 0; i < at_once; ++i) include(points[begin + i], i);
    for (std::size_t i = whole; i < points.size(); ++i) include(points[i], 0);
    for (std::size_t i = 1; i < at_once; ++i) {
      low[0] = low[i] < low[0] ? low[i] : low[0];
      high[0] = high[i] > high[0] ? high[i] : high[0];
    }
    std::memcpy(box.low.data(), &low[0], dim * sizeof(Scalar));
    std::memcpy(box.high.data(), &high[0], dim * sizeof(Scalar));
  } else {
    for (const Point& p : points) box.include(p.at);
  }
  return box;
}

/// A plane across an axis, and how many points lie below it; those at it may lie on either side.
template <class Scalar>
struct PointSplit {
  std::size_t axis;
  Scalar at;
  std::size_t below;
};

/// Orders points so that the first `count` lie below the plane through the next, or at it. Of the coordinates alone, in
/// `values`, the standard library picks the plane's: numbers are moved faster than points.
template <class Point, class Scalar>
void select_exactly(std::span<Point> points, std::span<Point> scratch, Scalar* values, std::size_t axis,
                    std::size_t count) {
  for (std::size_t i = 0; i < points.size(); ++i) values[i] = points[i].at[axis];
  std::nth_element(values, values + count, values + points.size());
  const Scalar at = values[count];
  std::size_t front = part_points(points, scratch, axis, at);
  for (std::size_t i = front; front <= count; ++i)
    if (points[i].at[axis] == at) std::swap(points[i], points[front++]);
}

/// Orders points so that the first `count`, one or more but not all, lie below a plane across an axis, the others
/// above.
///
/// Quickselect (Hoare 1961) by ranks of a sample, as Floyd and Rivest 1975 choose them, without a branch a point; small
/// parts, and many equal points, by all of their coordinates.
template <class Point, class Scalar = typename decltype(Point::at)::value_type>
[[nodiscard]] PointSplit<Scalar> select_points(std::span<Point> points, std::span<Point> scratch, std::size_t axis,
                                               std::size_t count) {
  constexpr std::size_t small = 64, large = 2048, most_rounds = 8;
  std::array<Scalar, 128> buffer;
  std::size_t begin = 0, end = points.size();
  for (std::size_t round = 0; round < most_rounds && end - begin > small; ++round) {
    const std::span<Scalar> sample(buffer.data(), end - begin < large ? 32 : 128);
    const std::size_t step = (end - begin) / sample.size(), beside = sample.size() / 16;
    for (std::size_t i = 0; i < sample.size(); ++i) sample[i] = points[begin + i * step].at[axis];
    // Beside the wanted rank on the side of fewer points: most likely they are all that is left.
    std::size_t rank = (count - begin) * sample.size() / (end - begin);
    rank = 2 * rank < sample.size() ? rank + beside : rank - beside;
    std::nth_element(sample.data(), sample.data() + rank, sample.data() + sample.size());
    const Scalar at = sample[rank];
    const std::size_t below = begin + part_points(points.subspan(begin, end - begin), scratch, axis, at);
    if (below == count) return {axis, at, below};
    if (below == begin) break;
    (below < count ? begin : end) = below;
  }
  const std::span<Point> left = points.subspan(begin, end - begin);
  std::vector<Scalar> larger_buffer(left.size() > buffer.size() ? left.size() : 0);
  select_exactly(left, scratch, larger_buffer.empty() ? buffer.data() : larger_buffer.data(), axis, count - begin);
  return {axis, points[count].at[axis], count};
}

/// Moves the plane of a split so that `count` points lie below it.
template <class Point, class Scalar>
void move_split(PointSplit<Scalar>& split, std::span<Point> points, std::span<Point> scratch, std::size_t count) {
  const std::size_t below = split.below;
  if (below == count) return;
  split = below > count ? select_points(points.first(below), scratch, split.axis, count)
                        : select_points(points.subspan(below), scratch, split.axis, count - below);
  split.below = count;
}

/// Orders points so that the first lie below a plane across the widest side of their box, the others above: `at_least`
/// to `at_most` below, the plane being in the middle of the box where that allows it. The middle keeps boxes compact
/// where LiDAR leaves lines of points, of which a median would make slivers.
template <class Point, class Scalar = typename decltype(Point::at)::value_type>
[[nodiscard]] PointSplit<Scalar> split_points(std::span<Point> points, std::span<Point> scratch, std::size_t at_least,
                                              std::size_t at_most) {
  const auto box = box_of_points(points);
  const std::size_t axis = box.widest_axis();
  const Scalar middle = box.low[axis] / 2 + box.high[axis] / 2;
  if (const std::size_t sample = 32, n = points.size(); n >= 8 * sample) {
    // Where a sample says that the middle will not do, the plane that will is sought at once.
    std::size_t sampled = 0;
    for (std::size_t i = 0; i < sample; ++i) sampled += points[i * (n / sample)].at[axis] < middle ? 1 : 0;
    const std::size_t low = (sampled + 2) * n / sample, high = (std::max<std::size_t>(sampled, 2) - 2) * n / sample;
    if (low < at_least || high > at_most) {
      const auto split = select_points(points, scratch, axis, low < at_least ? at_least : at_most);
      if (low < at_least ? split.at >= middle : split.at < middle) return split;
    }
  }
  const std::size_t below = part_points(points, scratch, axis, middle);
  PointSplit<Scalar> split{axis, middle, below};
  move_split(split, points, scratch, std::clamp(below, at_least, at_most));
  return split;
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
    const auto center = [axis](const Entry& entry) { return entry.box.low[axis] / 2 + entry.box.high[axis] / 2; };
    for (std::size_t i = 1; i < Count; ++i) {  // insertion sort
      const Entry inserted = entries[i];
      std::size_t place = i;
      for (; place > 0 && center(inserted) < center(entries[place - 1]); --place) entries[place] = entries[place - 1];
      entries[place] = inserted;
    }
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
