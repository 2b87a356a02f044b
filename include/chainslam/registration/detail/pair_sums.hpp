#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <span>

#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/registration/concepts.hpp"
#include "chainslam/registration/detail/match_columns.hpp"
#include "chainslam/registration/detail/normal_equations.hpp"
#include "chainslam/registration/detail/quad.hpp"
#include "chainslam/registration/detail/source_columns.hpp"
#include "chainslam/registration/metrics.hpp"

namespace chainslam::detail {

/// `AlignmentEquations` of four pairs at a time: with y from the pivot to the moved point, a pair adds
/// J' M J and J' M d for J = [I, -hat(y)].
class QuadSums {
 public:
  void add(const std::array<Quad, 3>& y, const PairTerms<Quad>& terms, const Quad& weight, const Quad& cost) {
    std::array<Quad, 6> m;
    std::array<Quad, 3> v;
    for (std::size_t i = 0; i < 6; ++i) m[i] = weight * terms.information[i];
    for (std::size_t i = 0; i < 3; ++i) v[i] = weight * terms.pull[i];
    // a = hat(y) M, row by row.
    const std::array<Quad, 9> a{y[1] * m[2] - y[2] * m[1], y[1] * m[4] - y[2] * m[3], y[1] * m[5] - y[2] * m[4],
                                y[2] * m[0] - y[0] * m[2], y[2] * m[1] - y[0] * m[4], y[2] * m[2] - y[0] * m[5],
                                y[0] * m[1] - y[1] * m[0], y[0] * m[3] - y[1] * m[1], y[0] * m[4] - y[1] * m[2]};
    for (std::size_t i = 0; i < 6; ++i) sums_[i] += m[i];
    for (std::size_t i = 0; i < 9; ++i) sums_[6 + i] += a[i];
    sums_[15] += y[1] * a[2] - y[2] * a[1];
    sums_[16] += y[2] * a[0] - y[0] * a[2];
    sums_[17] += y[0] * a[1] - y[1] * a[0];
    sums_[18] += y[2] * a[3] - y[0] * a[5];
    sums_[19] += y[0] * a[4] - y[1] * a[3];
    sums_[20] += y[0] * a[7] - y[1] * a[6];
    for (std::size_t i = 0; i < 3; ++i) sums_[21 + i] += v[i];
    sums_[24] += y[1] * v[2] - y[2] * v[1];
    sums_[25] += y[2] * v[0] - y[0] * v[2];
    sums_[26] += y[0] * v[1] - y[1] * v[0];
    sums_[27] += weight;
    sums_[28] += weight * terms.squared_residual;
    sums_[29] += cost;
  }
  /// @param inside  1 where there is a pair, else 0.
  void add_figures(const Quad& inside, const Quad& squared_residual, const Quad& squared_distance,
                   const Quad& squared_extent) {
    sums_[30] += inside;
    sums_[31] += inside * squared_residual;
    sums_[32] += inside * squared_distance;
    sums_[33] += inside * squared_extent;
  }

  [[nodiscard]] AlignmentEquations total() const {
    std::array<double, 34> s;
    for (std::size_t i = 0; i < s.size(); ++i) s[i] = sums_[i].sum();
    AlignmentEquations result;
    Matrix6d& H = result.hessian;
    set_block(H, 0, 0, symmetric_matrix(s[0], s[1], s[2], s[3], s[4], s[5]));
    for (int row = 0; row < 3; ++row)
      for (int column = 0; column < 3; ++column)
        H(3 + row, column) = H(column, 3 + row) = s[static_cast<std::size_t>(6 + 3 * row + column)];
    set_block(H, 3, 3, symmetric_matrix(s[15], s[16], s[17], s[18], s[19], s[20]));
    result.information = s[0] + s[3] + s[5];
    for (int i = 0; i < 6; ++i) result.gradient[i] = s[21 + static_cast<std::size_t>(i)];
    result.weight = s[27];
    result.weighted_square = s[28];
    result.cost = s[29];
    result.inliers = static_cast<Index>(s[30]);
    result.squared_residual = s[31];
    result.squared_distance = s[32];
    result.squared_extent = s[33];
    return result;
  }

 private:
  std::array<Quad, 34> sums_{};
};

/// Turns covariances: R C R'.
inline std::array<Quad, 6> turned(const Eigen::Matrix3d& R, const std::array<Quad, 6>& c) {
  const std::array<Quad, 3> x = rotated<Quad>(R, {c[0], c[1], c[2]}), y = rotated<Quad>(R, {c[1], c[3], c[4]}),
                            z = rotated<Quad>(R, {c[2], c[4], c[5]});
  const std::array<Quad, 3> first = rotated<Quad>(R, {x[0], y[0], z[0]}), second = rotated<Quad>(R, {x[1], y[1], z[1]}),
                            third = rotated<Quad>(R, {x[2], y[2], z[2]});
  return {first[0], first[1], first[2], second[1], second[2], third[2]};
}

template <class Number, int Rows>
[[nodiscard]] std::array<Quad, static_cast<std::size_t>(Rows)> load_rows(const Columns<Number, Rows>& columns,
                                                                         Index i) {
  std::array<Quad, static_cast<std::size_t>(Rows)> quads;
  for (int row = 0; row < Rows; ++row) quads[static_cast<std::size_t>(row)] = Quad::load(columns.at(row, i));
  return quads;
}

/// Everything that a pass over the pairs reads.
template <class Metric, class Kernel, class Target, class Matches>
struct Pairs {
  const Metric& metric;
  const Kernel& kernel;
  const SourceColumns& source;
  const Target& target;
  const Matches& matches;
  double squared_max_distance;
  std::span<const float> kept;  ///< 1 or 0 for each pair, padded to whole quads; empty: all

  /// Sums over pairs [begin, end) at a pose, begin a multiple of `Quad::size`; each pair keeps its match.
  [[nodiscard]] AlignmentEquations sum(const Placement& at, Index begin, Index end) const {
    QuadSums sums;
    const Quad farthest(squared_max_distance);
    for (Index i = begin; i < end; i += Quad::size) {
      const std::array<Quad, 3> y = rotated(at.rotation, load_rows(source.positions, i));
      const std::array<Quad, 3> q = load_rows(matches.positions(), i);
      SurfacePair<Quad> pair;
      for (std::size_t axis = 0; axis < 3; ++axis)
        pair.offset[axis] = y[axis] + (at.pivot[static_cast<Eigen::Index>(axis)] - q[axis]);
      auto& d = pair.offset;
      const Quad squared_distance = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
      Quad inside = Quad::where_at_most(squared_distance, farthest, 1.0, 0.0);
      if (!kept.empty()) inside = inside * Quad::load(kept.data() + i);
      const Quad half(0.5);  // lanes without a pair: no far offsets, whose products would not be finite
      for (Quad& along : d) along = Quad::where_at_most(half, inside, along, 0.0);
      PairTerms<Quad> terms;
      evaluate(at, i, end, inside, y, pair, terms);
      Quad weight = inside, cost = inside * terms.squared_residual;
      weigh(terms.squared_residual, weight, cost);
      sums.add(y, terms, weight, cost);
      sums.add_figures(inside, terms.squared_residual, Quad::where_at_most(half, inside, squared_distance, 0.0),
                       y[0] * y[0] + y[1] * y[1] + y[2] * y[2]);
    }
    return sums.total();
  }

 private:
  void evaluate(const Placement& at, Index i, Index end, const Quad& inside, const std::array<Quad, 3>& y,
                SurfacePair<Quad>& pair, PairTerms<Quad>& terms) const {
    if constexpr (SurfaceMetric<Metric>) {
      if constexpr (Metric::source_surface == Surface::normal)
        pair.source_normal = rotated(at.rotation, load_rows(source.normals, i));
      if constexpr (Metric::source_surface == Surface::covariance)
        pair.source_covariance = turned(at.rotation, load_rows(source.covariances, i));
      if constexpr (Metric::target_surface == Surface::normal) pair.target_normal = load_rows(matches.surfaces(), i);
      if constexpr (Metric::target_surface == Surface::covariance)
        pair.target_covariance = load_rows(matches.surfaces(), i);
      metric.evaluate(pair, terms);
    } else {
      terms = {};
      for (int lane = 0; lane < Quad::size && i + lane < end; ++lane)
        if (inside[lane] > 0) evaluate_one(at, i + lane, lane, {y[0][lane], y[1][lane], y[2][lane]}, terms);
    }
  }

  /// One pair by a metric of the pairwise kind: M = G'G and M d = G'e.
  void evaluate_one(const Placement& at, Index i, int lane, const Eigen::Vector3d& y, PairTerms<Quad>& terms) const {
    const auto error = metric.error(target, matches.index(i), y + at.pivot);
    constexpr int rows = decltype(metric.error(target, 0, y))::rows;
    const Eigen::Matrix<double, rows, 3> gradient = error.gradient;
    const Eigen::Matrix<double, rows, 1> residual = error.residual;
    const Eigen::Matrix3d M = transposed_product(gradient, gradient);
    const Eigen::Vector3d pull = transposed_product(gradient, residual);
    constexpr std::array<std::array<int, 2>, 6> upper{{{0, 0}, {0, 1}, {0, 2}, {1, 1}, {1, 2}, {2, 2}}};
    for (std::size_t k = 0; k < 6; ++k) terms.information[k].set(lane, M(upper[k][0], upper[k][1]));
    for (std::size_t k = 0; k < 3; ++k) terms.pull[k].set(lane, pull[static_cast<Eigen::Index>(k)]);
    terms.squared_residual.set(lane, residual.squaredNorm());
  }

  void weigh(const Quad& squared_residual, Quad& weight, Quad& cost) const {
    if constexpr (!std::same_as<Kernel, Trivial>) {
      for (int lane = 0; lane < Quad::size; ++lane) {
        const double inside = weight[lane];
        weight.set(lane, inside * kernel.weight(squared_residual[lane]));
        if constexpr (RobustCost<Kernel>) cost.set(lane, inside * kernel.cost(squared_residual[lane]));
      }
    }
  }
};

}  // namespace chainslam::detail
