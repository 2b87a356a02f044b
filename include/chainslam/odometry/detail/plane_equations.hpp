#pragma once

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/lanes.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/odometry/detail/plane_matches.hpp"

namespace chainslam::detail {

/// Eight points of a scan and their planes, in columns. Where there is no plane the normal is zero.
struct PlaneBlock {
  static constexpr std::size_t width = 8;
  using Column = std::array<float, width>;
  using Columns = std::array<Column, 3>;

  Columns point{};           ///< body frame, metres
  Column squared_range{};    ///< m^2
  Column root_of_range{};    ///< its square root, m^0.5
  Columns normal{}, side{};  ///< of the planes, and their long side
  Columns anchor{};          ///< metres from an origin near the scan
  Column long_tilt{}, short_tilt{};

  void set_point(std::size_t lane, const Eigen::Vector3d& p) {
    put(converted<float>(p), lane, point);
    squared_range[lane] = static_cast<float>(p.squaredNorm());
    root_of_range[lane] = std::sqrt(std::sqrt(squared_range[lane]));
  }
  void set_plane(std::size_t lane, const MatchedPlane& plane) {
    put(plane.normal, lane, normal);
    put(plane.anchor, lane, anchor);
    put(plane.long_side, lane, side);
    long_tilt[lane] = plane.long_tilt;
    short_tilt[lane] = plane.short_tilt;
  }

 private:
  static void put(const Eigen::Vector3f& v, std::size_t lane, Columns& columns) {
    for (std::size_t axis = 0; axis < 3; ++axis) columns[axis][lane] = v[static_cast<Eigen::Index>(axis)];
  }
};

/// Sums over matches for one Gauss-Newton step on the pose; tangent [translation; rotation].
struct PlaneEquations {
  Matrix6d hessian = zeros<Matrix6d>();   ///< sum w J J^T
  Vector6d gradient = zeros<Vector6d>();  ///< sum w J r
  double weight = 0;                      ///< sum w
  double squared_residuals = 0;           ///< sum w r^2, m^2
  double squared_ranges = 0;              ///< sum w |p|^2, m^2
  Matrix6d noise = zeros<Matrix6d>();     ///< the part of the Hessian to be expected from the normals' noise alone
  Index matches = 0;
};

/// Which residuals count: up to the larger of `per_root_of_range` sqrt(range) and `least`, metres.
struct ResidualGate {
  double per_root_of_range = 0;
  double least = 0;
};

/// Sums of `PlaneEquations` in lanes, with rows of J in the map's axes: [n; q x n] for a point at q from the body.
///
/// Sums of one chunk of points are taken in float, lane by lane, in the same order for any width of registers.
class PlaneSums {
 public:
  /// @param weight  `double weight(double squared_residual)`.
  template <class Weight>
  void add(const PlaneBlock& block, const std::array<float, 9>& R, const std::array<float, 3>& t,
           const ResidualGate& gate, Weight&& weight) {
    for (std::size_t first = 0; first < PlaneBlock::width; first += lane_count)
      add_lanes(block, first, R, t, gate, weight);
  }

  /// Adds these sums, in the body's axes. @param R  of T_map_body.
  void add_to(const Eigen::Matrix3d& R, PlaneEquations& equations) const;

 private:
  using Row = std::array<FloatLanes, 6>;
  enum Place : std::size_t { hessian = 0, noise = 21, gradient = 42, weights = 48, residuals, ranges, matches, count };

  template <class Weight>
  void add_lanes(const PlaneBlock& block, std::size_t first, const std::array<float, 9>& R,
                 const std::array<float, 3>& t, const ResidualGate& gate, Weight&& weight);

  void accumulate(std::size_t place, std::size_t first, const FloatLanes& value) {
    float* at = sums_[place].data() + first;
    FloatLanes sum;
    load(at, sum);
    sum += value;
    store(sum, at);
  }
  /// Adds w row row^T.
  void accumulate_square(std::size_t place, std::size_t first, const Row& row, const FloatLanes& w) {
    for (std::size_t j = 0; j < 6; ++j) {
      const FloatLanes weighed = w * row[j];
      for (std::size_t i = 0; i <= j; ++i) accumulate(place++, first, weighed * row[i]);
    }
  }
  static void set_row(const FloatLanes* q, const FloatLanes* n, Row& row) {
    row = {n[0], n[1], n[2], q[1] * n[2] - q[2] * n[1], q[2] * n[0] - q[0] * n[2], q[0] * n[1] - q[1] * n[0]};
  }
  static void load_three(const PlaneBlock::Columns& columns, std::size_t first, FloatLanes* to) {
    for (std::size_t axis = 0; axis < 3; ++axis) load(columns[axis].data() + first, to[axis]);
  }
  [[nodiscard]] double sum(std::size_t place) const {
    double all = 0;
    for (const float lane : sums_[place]) all += static_cast<double>(lane);
    return all;
  }
  /// The 6x6 matrix of the sums from `place` on, in the body's axes.
  void add_square_to(std::size_t place, const Eigen::Matrix3d& R, Matrix6d& matrix) const;

  alignas(64) std::array<PlaneBlock::Column, count> sums_{};
};

template <class Weight>
void PlaneSums::add_lanes(const PlaneBlock& block, std::size_t first, const std::array<float, 9>& R,
                          const std::array<float, 3>& t, const ResidualGate& gate, Weight&& weight) {
  FloatLanes p[3], q[3], n[3], anchor[3];
  load_three(block.normal, first, n);
  const FloatLanes squared_length = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
  MaskLanes counts = squared_length > 0.0F;
  if (!any(counts)) return;
  load_three(block.point, first, p);
  load_three(block.anchor, first, anchor);
  for (std::size_t i = 0; i < 3; ++i) q[i] = R[i] * p[0] + R[3 + i] * p[1] + R[6 + i] * p[2];
  FloatLanes residual{};
  for (std::size_t i = 0; i < 3; ++i) residual += n[i] * (q[i] + (t[i] - anchor[i]));
  FloatLanes limit;
  load(block.root_of_range.data() + first, limit);
  limit *= static_cast<float>(gate.per_root_of_range);
  const FloatLanes least = static_cast<float>(gate.least) + FloatLanes{};
  limit = limit > least ? limit : least;
  counts &= (residual <= limit) & (residual >= -limit);

  const FloatLanes squared = residual * residual;
  std::array<float, lane_count> each;
  for (std::size_t lane = 0; lane < lane_count; ++lane)
    each[lane] = static_cast<float>(weight(static_cast<double>(squared[lane])));
  FloatLanes w;
  load(each.data(), w);
  choose(counts, w, FloatLanes{}, w);

  Row row;
  set_row(q, n, row);
  accumulate_square(hessian, first, row, w);
  const FloatLanes pull = w * residual;
  for (std::size_t i = 0; i < 6; ++i) accumulate(gradient + i, first, pull * row[i]);
  FloatLanes squared_range;
  load(block.squared_range.data() + first, squared_range);
  accumulate(weights, first, w);
  accumulate(residuals, first, pull * residual);
  accumulate(ranges, first, w * squared_range);
  accumulate(matches, first, counts ? FloatLanes{} + 1.0F : FloatLanes{});

  FloatLanes tilt, side[3];
  load(block.long_tilt.data() + first, tilt);
  if (!any(tilt > 0.0F)) return;
  load_three(block.side, first, side);
  set_row(q, side, row);
  accumulate_square(noise, first, row, w * tilt);
  const FloatLanes across[3] = {n[1] * side[2] - n[2] * side[1], n[2] * side[0] - n[0] * side[2],
                                n[0] * side[1] - n[1] * side[0]};
  load(block.short_tilt.data() + first, tilt);
  set_row(q, across, row);
  accumulate_square(noise, first, row, w * tilt);
}

inline void PlaneSums::add_square_to(std::size_t place, const Eigen::Matrix3d& R, Matrix6d& matrix) const {
  Matrix6d square;
  for (int j = 0; j < 6; ++j)
    for (int i = 0; i <= j; ++i) square(i, j) = square(j, i) = sum(place++);
  const Eigen::Matrix3d R_transposed = transposed(R);
  for (int j = 0; j < 6; j += 3)
    for (int i = 0; i < 6; i += 3) {
      const Eigen::Matrix3d turned = product(R_transposed, product(block_of<3, 3>(square, i, j), R));
      set_block(matrix, i, j, sum_of(Eigen::Matrix3d(block_of<3, 3>(matrix, i, j)), turned));
    }
}

inline void PlaneSums::add_to(const Eigen::Matrix3d& R, PlaneEquations& equations) const {
  add_square_to(hessian, R, equations.hessian);
  add_square_to(noise, R, equations.noise);
  const Eigen::Matrix3d R_transposed = transposed(R);
  for (int part = 0; part < 6; part += 3) {
    const auto at = gradient + static_cast<std::size_t>(part);
    const Eigen::Vector3d turned = product(R_transposed, Eigen::Vector3d(sum(at), sum(at + 1), sum(at + 2)));
    for (int i = 0; i < 3; ++i) equations.gradient[part + i] += turned[i];
  }
  equations.weight += sum(weights);
  equations.squared_residuals += sum(residuals);
  equations.squared_ranges += sum(ranges);
  equations.matches += static_cast<Index>(sum(matches));
}

inline constexpr Index blocks_a_chunk = 64;  ///< 512 points

/// @param origin  from where the planes' anchors count, in the map's frame.
/// @param weight  `double weight(double squared_residual)`.
/// The residual is r = n . (R p + t - a); moving the pose by exp([v; w]) on the right changes it by m . v + (p x m) . w
/// with m = R^T n.
template <Executor E, class Weight>
[[nodiscard]] PlaneEquations plane_equations(const std::vector<PlaneBlock>& blocks, const Eigen::Vector3d& origin,
                                             const SE3d& T_map_body, const ResidualGate& gate, Weight&& weight,
                                             const E& executor) {
  const Eigen::Matrix3d R = T_map_body.rotation().matrix();
  const Eigen::Vector3d off = difference_of(T_map_body.translation(), origin);
  std::array<float, 9> R_float;
  std::array<float, 3> t_float;
  for (std::size_t i = 0; i < 9; ++i) R_float[i] = static_cast<float>(R.data()[i]);
  for (std::size_t i = 0; i < 3; ++i) t_float[i] = static_cast<float>(off[static_cast<Eigen::Index>(i)]);
  std::vector<PlaneSums> parts(static_cast<std::size_t>(count_chunks(to_index(blocks.size()), blocks_a_chunk)));
  executor.for_chunks(to_index(blocks.size()), blocks_a_chunk, [&](Index begin, Index end) {
    PlaneSums& sums = parts[static_cast<std::size_t>(begin / blocks_a_chunk)];
    for (auto i = static_cast<std::size_t>(begin); i < static_cast<std::size_t>(end); ++i)
      sums.add(blocks[i], R_float, t_float, gate, weight);
  });
  PlaneEquations all;
  for (const PlaneSums& part : parts) part.add_to(R, all);
  return all;
}

}  // namespace chainslam::detail
