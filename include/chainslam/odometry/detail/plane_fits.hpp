#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>

#include "chainslam/core/lanes.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/odometry/detail/plane_matches.hpp"

namespace chainslam::detail {

/// Neighbours of as many points as a register has lanes, whose planes are fitted and judged at a time, as
/// `centred_plane` judges one, but in float: about the mean, that is good to some 1e-5 rad and 1e-6 m.
template <std::size_t Count>
class PlaneFits {
 public:
  [[nodiscard]] bool full() const { return used_ == lane_count; }

  /// Begins with the neighbours of a point, of which there are `Count`.
  void add(std::size_t point) {
    points_[used_++] = point;
    neighbor_ = 0;
  }
  /// @param position  3 x float, metres from an origin within some 100 m.
  void add_neighbor(const Eigen::Vector3f& position) {
    for (std::size_t axis = 0; axis < 3; ++axis)
      at_[neighbor_][axis][used_ - 1] = position[static_cast<Eigen::Index>(axis)];
    ++neighbor_;
  }

  /// Fits the planes of what was added, calls `take(point, plane)` for each, and forgets it. Anchors count from the
  /// origin, too.
  template <class Take>
  void fit(const PlaneRule& rule, Take&& take) {
    if (used_ == 0) return;
    Fitted planes;
    fit_least_squares(planes);
    judge(rule, planes);
    for (std::size_t lane = 0; lane < used_; ++lane) take(points_[lane], plane_in(planes, lane));
    used_ = 0;
  }

 private:
  using Vectors = std::array<FloatLanes, 3>;
  using Lane = std::size_t;

  struct Fitted {
    Vectors mean;
    std::array<Vectors, Count> off;  ///< from the mean
    OuterEigen<FloatLanes> eigen;
    FloatLanes long_tilt, short_tilt;
    MaskLanes good;
  };

  [[nodiscard]] static Eigen::Vector3f vector_in(const Vectors& v, Lane lane) {
    return {v[0][lane], v[1][lane], v[2][lane]};
  }
  static void dot(const Vectors& a, const Vectors& b, FloatLanes& to) { to = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

  void fit_least_squares(Fitted& planes) const {
    constexpr float share = 1.0F / static_cast<float>(Count);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      FloatLanes sum{};
      for (std::size_t i = 0; i < Count; ++i) {
        planes.off[i][axis] = at_[i][axis] - at_[0][axis];
        sum += planes.off[i][axis];
      }
      const FloatLanes mean = sum * share;
      for (Vectors& off : planes.off) off[axis] -= mean;
      planes.mean[axis] = at_[0][axis] + mean;
    }
    SymmetricMatrices<FloatLanes> sums{};
    for (const Vectors& d : planes.off) {
      sums.xx += d[0] * d[0];
      sums.xy += d[0] * d[1];
      sums.xz += d[0] * d[2];
      sums.yy += d[1] * d[1];
      sums.yz += d[1] * d[2];
      sums.zz += d[2] * d[2];
    }
    for (FloatLanes* sum : {&sums.xx, &sums.xy, &sums.xz, &sums.yy, &sums.yz, &sums.zz}) *sum *= share;
    eigenvectors(sums, planes.eigen);
    // Next to the others, the least eigenvalue is lost in rounding; as a mean of squares it is not.
    planes.eigen.values[0] = FloatLanes{};
    for (const Vectors& d : planes.off) {
      FloatLanes height;
      dot(planes.eigen.vector, d, height);
      planes.eigen.values[0] += height * height * share;
    }
    constexpr float line_ratio = 1e-6F;  // of variances: as in `fit_plane`, but for the rounding of float
    planes.good = planes.eigen.values[1] > line_ratio * planes.eigen.values[2];
  }

  /// As `centred_plane` does.
  void judge(const PlaneRule& rule, Fitted& planes) const {
    constexpr auto n = static_cast<float>(Count);
    const auto max_deviation = static_cast<float>(rule.max_deviation);
    const auto [nx, ny, nz] = planes.eigen.vector;
    const auto [tx, ty, tz] = planes.eigen.largest;
    const Vectors across{ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx};
    planes.good &= planes.eigen.values[1] >= static_cast<float>(rule.min_width * rule.min_width);
    const FloatLanes inverse_long = 1.0F / planes.eigen.values[2], inverse_short = 1.0F / planes.eigen.values[1];
    for (const Vectors& d : planes.off) {
      FloatLanes height, u, v;
      dot(planes.eigen.vector, d, height);
      dot(planes.eigen.largest, d, u);
      dot(across, d, v);
      const FloatLanes leverage = (1.0F + u * u * inverse_long + v * v * inverse_short) * (1.0F / n);
      planes.good &= (height <= max_deviation) & (height >= -max_deviation);
      planes.good &= leverage <= static_cast<float>(max_leverage);
    }
    const FloatLanes least = static_cast<float>(rule.least_noise * rule.least_noise) / n + FloatLanes{};
    const FloatLanes noise = planes.eigen.values[0] * (1.0F / (n - 3));
    const FloatLanes variance = noise > least ? noise : least;
    planes.long_tilt = variance * inverse_long;
    planes.short_tilt = variance * inverse_short;
  }

  [[nodiscard]] static MatchedPlane plane_in(const Fitted& planes, Lane lane) {
    if (planes.good[lane] == 0) return {};
    return {vector_in(planes.eigen.vector, lane), vector_in(planes.mean, lane), vector_in(planes.eigen.largest, lane),
            planes.long_tilt[lane], planes.short_tilt[lane]};
  }

  std::size_t used_ = 0, neighbor_ = 0;
  std::array<std::size_t, lane_count> points_{};
  std::array<Vectors, Count> at_{};
};

}  // namespace chainslam::detail
