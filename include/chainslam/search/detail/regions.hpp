#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
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
  [[nodiscard]] bool contains(const Eigen::Matrix<Scalar, Dim, 1>& p) const { return box.contains(p); }
  [[nodiscard]] Overlap overlap(const Eigen::AlignedBox<double, Dim>& other) const {
    const Eigen::AlignedBox<double, Dim> region = box.template cast<double>();
    if (region.contains(other)) return Overlap::inside;
    return region.intersects(other) ? Overlap::partly : Overlap::outside;
  }
};

/// The points whose squared distance to a centre is below a bound.
template <class Scalar, int Dim = 3>
struct BallRegion {
  Eigen::Matrix<Scalar, Dim, 1> center;
  Scalar bound;

  /// A little too large: rounding only ever makes a ball smaller.
  [[nodiscard]] Eigen::AlignedBox<double, Dim> bounds() const {
    const Eigen::Matrix<double, Dim, 1> c = center.template cast<double>();
    const double reach = std::sqrt(static_cast<double>(bound)) * (2 - below_float_rounding);
    return {c.array() - reach, c.array() + reach};
  }
  [[nodiscard]] bool contains(const Eigen::Matrix<Scalar, Dim, 1>& p) const {
    return (p - center).squaredNorm() < bound;
  }
  [[nodiscard]] Overlap overlap(const Eigen::AlignedBox<double, Dim>& other) const {
    const Eigen::Matrix<double, Dim, 1> c = center.template cast<double>();
    const Eigen::Matrix<double, Dim, 1> farthest = (other.min() - c).cwiseAbs().cwiseMax((other.max() - c).cwiseAbs());
    if (farthest.squaredNorm() * (2 - below_float_rounding) < static_cast<double>(bound)) return Overlap::inside;
    const bool apart = other.squaredExteriorDistance(c) * below_float_rounding >= static_cast<double>(bound);
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

}  // namespace chainslam::detail
