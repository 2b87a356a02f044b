#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "chainslam/search/detail/pack.hpp"

namespace chainslam::detail {

/// An axis-aligned box with its rim; empty at first.
template <class Scalar, int Dim>
struct Bounds {
  std::array<Scalar, Dim> low = filled(std::numeric_limits<Scalar>::infinity());
  std::array<Scalar, Dim> high = filled(-std::numeric_limits<Scalar>::infinity());

  static constexpr std::array<Scalar, Dim> filled(Scalar value) {
    std::array<Scalar, Dim> values{};
    values.fill(value);
    return values;
  }
  void include(const std::array<Scalar, Dim>& p) {
    for (std::size_t axis = 0; axis < Dim; ++axis) {
      low[axis] = std::min(low[axis], p[axis]);
      high[axis] = std::max(high[axis], p[axis]);
    }
  }
  void include(const Bounds& other) {
    include(other.low);
    include(other.high);
  }
  /// Whether a side of the box goes through a point of it.
  [[nodiscard]] bool touches_rim(const std::array<Scalar, Dim>& p) const {
    bool touches = false;
    for (std::size_t axis = 0; axis < Dim; ++axis) touches |= p[axis] <= low[axis] || p[axis] >= high[axis];
    return touches;
  }
  /// The sum of the sides: what boxes of points on surfaces are compared by, whose volumes are near zero.
  [[nodiscard]] Scalar margin() const {
    Scalar sum = 0;
    for (std::size_t axis = 0; axis < Dim; ++axis) sum += high[axis] - low[axis];
    return sum;
  }
  [[nodiscard]] std::size_t widest_axis() const {
    std::size_t widest = 0;
    for (std::size_t axis = 1; axis < Dim; ++axis)
      if (high[axis] - low[axis] > high[widest] - low[widest]) widest = axis;
    return widest;
  }
};

/// A child of a node, on its way from one node to another.
template <class Scalar, int Dim>
struct BoxEntry {
  Bounds<Scalar, Dim> box;
  std::uint32_t link;    ///< of a node, or packed `RunLink` of a leaf
  std::uint32_t points;  ///< in a leaf; 0 for a node
};

/// Up to eight children with their tight boxes side by side, so that one pass tells how far all of them are. Lanes not
/// in use, which come last, hold empty boxes, infinitely far.
template <class Scalar, int Dim>
struct alignas(64) BoxNode {
  using Entry = BoxEntry<Scalar, Dim>;
  static constexpr std::size_t width = pack_width;

  std::array<std::array<Scalar, width>, Dim> low, high;
  std::array<std::uint32_t, width> link;
  std::array<std::uint8_t, width> points;
  std::uint32_t count;

  void clear() {
    for (auto& axis : low) axis.fill(std::numeric_limits<Scalar>::infinity());
    for (auto& axis : high) axis.fill(-std::numeric_limits<Scalar>::infinity());
    link.fill(0);
    points.fill(0);
    count = 0;
  }

  [[nodiscard]] Bounds<Scalar, Dim> box(std::size_t lane) const {
    Bounds<Scalar, Dim> b;
    for (std::size_t axis = 0; axis < Dim; ++axis) {
      b.low[axis] = low[axis][lane];
      b.high[axis] = high[axis][lane];
    }
    return b;
  }
  void set_box(std::size_t lane, const Bounds<Scalar, Dim>& b) {
    for (std::size_t axis = 0; axis < Dim; ++axis) {
      low[axis][lane] = b.low[axis];
      high[axis][lane] = b.high[axis];
    }
  }
  void include(std::size_t lane, const std::array<Scalar, Dim>& p) {
    for (std::size_t axis = 0; axis < Dim; ++axis) {
      low[axis][lane] = std::min(low[axis][lane], p[axis]);
      high[axis][lane] = std::max(high[axis][lane], p[axis]);
    }
  }
  /// The box of all children.
  [[nodiscard]] Bounds<Scalar, Dim> box() const {
    Bounds<Scalar, Dim> all;
    for (std::size_t axis = 0; axis < Dim; ++axis) {
      for (std::size_t lane = 0; lane < width; ++lane) {
        all.low[axis] = std::min(all.low[axis], low[axis][lane]);
        all.high[axis] = std::max(all.high[axis], high[axis][lane]);
      }
    }
    return all;
  }

  [[nodiscard]] Entry entry(std::size_t lane) const { return {box(lane), link[lane], points[lane]}; }
  void set(std::size_t lane, const Entry& entry) {
    set_box(lane, entry.box);
    link[lane] = entry.link;
    points[lane] = static_cast<std::uint8_t>(entry.points);
  }
  void push_back(const Entry& entry) { set(count++, entry); }
  /// The last child takes the place of the one that goes.
  void remove(std::size_t lane) {
    set(lane, entry(--count));
    set(count, {{}, 0, 0});
  }

  /// Bit i is set where the box of child i touches a box.
  [[nodiscard]] unsigned touching(const Bounds<Scalar, Dim>& other) const {
    Pack<Scalar> apart = Pack<Scalar>::all(0);
    for (std::size_t axis = 0; axis < Dim; ++axis) {
      apart = max(apart, Pack<Scalar>::load(low[axis].data()) - Pack<Scalar>::all(other.high[axis]));
      apart = max(apart, Pack<Scalar>::all(other.low[axis]) - Pack<Scalar>::load(high[axis].data()));
    }
    return apart.at_most(0) & ((1U << count) - 1);
  }

  /// Squared distances of the query to the boxes; never more than what arithmetic in Scalar makes of the distance to a
  /// point inside, where multiplication and addition may be fused in another way.
  [[nodiscard]] Pack<Scalar> squared_distances(const Scalar* query) const {
    constexpr Scalar below_rounding = 1 - 4 * std::numeric_limits<Scalar>::epsilon();
    return sum_of_squares(query, 0) * Pack<Scalar>::all(below_rounding);
  }
  /// Those as keys (see `Pack::keys`): below the distance to a point inside, or below `least_bound`.
  [[nodiscard]] Pack<Scalar> keys(const Scalar* query) const {
    constexpr Scalar below_rounding = 1 - 12 * std::numeric_limits<Scalar>::epsilon();
    // Keys of boxes that hold the query differ by their lanes' numbers, and must not be so small that a processor may
    // take them for zero.
    constexpr Scalar least_gap = sizeof(Scalar) == 4 ? Scalar(1.5e-19) : Scalar(2e-154);
    return (sum_of_squares(query, least_gap) * Pack<Scalar>::all(below_rounding)).keys();
  }
  static constexpr Scalar least_bound = sizeof(Scalar) == 4 ? Scalar(1e-37) : Scalar(1e-306);

 private:
  /// Of the gaps along the axes, each taken for `least` at least.
  [[nodiscard]] Pack<Scalar> sum_of_squares(const Scalar* query, Scalar least) const {
    Pack<Scalar> sum = Pack<Scalar>::all(0);
    for (std::size_t axis = 0; axis < static_cast<std::size_t>(Dim); ++axis) {
      const Pack<Scalar> q = Pack<Scalar>::all(query[axis]);
      const Pack<Scalar> beside =
          max(max(Pack<Scalar>::load(low[axis].data()) - q, q - Pack<Scalar>::load(high[axis].data())),
              Pack<Scalar>::all(least));
      sum = axis == 0 ? beside * beside : sum + beside * beside;
    }
    return sum;
  }
};

}  // namespace chainslam::detail
