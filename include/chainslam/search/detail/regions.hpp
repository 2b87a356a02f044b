#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace chainslam::detail {

/// How a box lies to a region. `partly` may be said of any box; the others are certain.
enum class Overlap { outside, partly, inside };

/// Takes a bound below any sum of squares that float arithmetic may make of the same distance.
inline constexpr double below_float_rounding = 1.0 - 1e-6;

/// The points of a closed box.
template <class Scalar, int Dim = 3>
struct BoxRegion {
  Eigen::AlignedBox<Scalar, Dim> box;

  [[nodiscard]] Eigen::AlignedBox<double, Dim> bounds() const { return box.template cast<double>(); }
  [[nodiscard]] bool contains(const Eigen::Matrix<Scalar, Dim, 1>& p) const {
    for (Eigen::Index axis = 0; axis < Dim; ++axis)
      if (!(box.min()[axis] <= p[axis] && p[axis] <= box.max()[axis])) return false;
    return true;
  }
  [[nodiscard]] Overlap overlap(const Eigen::AlignedBox<double, Dim>& other) const {
    bool inside = true;
    for (Eigen::Index axis = 0; axis < Dim; ++axis) {
      const auto low = static_cast<double>(box.min()[axis]), high = static_cast<double>(box.max()[axis]);
      if (!(low <= other.max()[axis] && other.min()[axis] <= high)) return Overlap::outside;
      inside = inside && low <= other.min()[axis] && other.max()[axis] <= high;
    }
    return inside ? Overlap::inside : Overlap::partly;
  }
};

/// The points whose squared distance to a centre is below a bound.
template <class Scalar, int Dim = 3>
struct BallRegion {
  Eigen::Matrix<Scalar, Dim, 1> center;
  Scalar bound;

  /// A little too large: rounding only ever makes a ball smaller.
  [[nodiscard]] Eigen::AlignedBox<double, Dim> bounds() const {
    const double reach = std::sqrt(static_cast<double>(bound)) * (2 - below_float_rounding);
    Eigen::AlignedBox<double, Dim> box;
    for (Eigen::Index axis = 0; axis < Dim; ++axis) {
      box.min()[axis] = static_cast<double>(center[axis]) - reach;
      box.max()[axis] = static_cast<double>(center[axis]) + reach;
    }
    return box;
  }
  [[nodiscard]] bool contains(const Eigen::Matrix<Scalar, Dim, 1>& p) const {
    Scalar squared = 0;
    for (Eigen::Index axis = 0; axis < Dim; ++axis) squared += (p[axis] - center[axis]) * (p[axis] - center[axis]);
    return squared < bound;
  }
  [[nodiscard]] Overlap overlap(const Eigen::AlignedBox<double, Dim>& other) const {
    double farthest = 0, nearest = 0;  // squared, of the box's points
    for (Eigen::Index axis = 0; axis < Dim; ++axis) {
      const auto c = static_cast<double>(center[axis]);
      const double below = other.min()[axis] - c, above = c - other.max()[axis];
      const double far = std::max(std::abs(below), std::abs(above)), near = std::max(std::max(below, above), 0.0);
      farthest += far * far;
      nearest += near * near;
    }
    if (farthest * (2 - below_float_rounding) < static_cast<double>(bound)) return Overlap::inside;
    const bool apart = nearest * below_float_rounding >= static_cast<double>(bound);
    return apart ? Overlap::outside : Overlap::partly;
  }
};

/// Everything else.
template <class Region>
struct Complement {
  Region region;

  template <class Vector>
  [[nodiscard]] bool contains(const Vector& p) const {
    return !region.contains(p);
  }
  template <class Box>
  [[nodiscard]] Overlap overlap(const Box& box) const {
    const Overlap inner = region.overlap(box);
    if (inner == Overlap::partly) return inner;
    return inner == Overlap::inside ? Overlap::outside : Overlap::inside;
  }
};

/// The region that holds everything.
struct Everywhere {
  template <class Box>
  [[nodiscard]] Overlap overlap(const Box&) const {
    return Overlap::inside;
  }
  template <class Vector>
  [[nodiscard]] bool contains(const Vector&) const {
    return true;
  }
};

/// A region of which only its points know.
struct Somewhere {
  template <class Box>
  [[nodiscard]] Overlap overlap(const Box&) const {
    return Overlap::partly;
  }
};

/// One of the points at a place: no box lies inside.
template <class Scalar, int Dim>
struct PointRegion {
  Eigen::Matrix<Scalar, Dim, 1> p;

  [[nodiscard]] Overlap overlap(const Eigen::AlignedBox<double, Dim>& box) const {
    return box.contains(p.template cast<double>().eval()) ? Overlap::partly : Overlap::outside;
  }
};

/// The same region in double: what it says of boxes stays the same.
template <class Scalar, int Dim>
[[nodiscard]] BoxRegion<double, Dim> widened(const BoxRegion<Scalar, Dim>& region) {
  return {region.bounds()};
}
template <class Scalar, int Dim>
[[nodiscard]] BallRegion<double, Dim> widened(const BallRegion<Scalar, Dim>& region) {
  return {region.center.template cast<double>(), static_cast<double>(region.bound)};
}
template <class Region>
[[nodiscard]] auto widened(const Complement<Region>& region) {
  return Complement<decltype(widened(region.region))>{widened(region.region)};
}

/// A region whose points are farther than `margin` along each axis from what is outside the given one; where that is
/// not worked out, one of which nothing is certain.
template <class Region>
[[nodiscard]] Somewhere shrunk(const Region&, double /*margin*/) {
  return {};
}
template <class Scalar, int Dim>
[[nodiscard]] BoxRegion<Scalar, Dim> shrunk(const BoxRegion<Scalar, Dim>& region, double margin) {
  BoxRegion<Scalar, Dim> result = region;
  const auto outwards = static_cast<Scalar>(margin < 0 ? -HUGE_VAL : HUGE_VAL);
  for (Eigen::Index axis = 0; axis < Dim; ++axis) {
    const double low = static_cast<double>(region.box.min()[axis]), high = static_cast<double>(region.box.max()[axis]);
    result.box.min()[axis] = std::nextafter(static_cast<Scalar>(low + margin), outwards);
    result.box.max()[axis] = std::nextafter(static_cast<Scalar>(high - margin), -outwards);
  }
  return result;
}
template <class Scalar, int Dim>
[[nodiscard]] BallRegion<Scalar, Dim> shrunk(const BallRegion<Scalar, Dim>& region, double margin) {
  const double rounding = margin < 0 ? 1 + 1e-5 : 1 - 1e-5;
  const double reach = std::sqrt(static_cast<double>(region.bound)) * rounding - margin * std::sqrt(Dim);
  return {region.center, static_cast<Scalar>(reach > 0 ? reach * reach : 0)};
}
template <class Region>
[[nodiscard]] auto shrunk(const Complement<Region>& region, double margin) {
  return Complement<decltype(shrunk(region.region, -margin))>{shrunk(region.region, -margin)};
}

}  // namespace chainslam::detail
