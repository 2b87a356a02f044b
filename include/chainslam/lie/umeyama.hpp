#pragma once

#include <Eigen/Core>
#include <cmath>
#include <optional>
#include <span>
#include <stdexcept>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/symmetric_eigen.hpp"
#include "chainslam/lie/sim3.hpp"

namespace chainslam::detail {

/// Horn's matrix: q' N q is the sum of target . (R(q) source) for unit q = (x, y, z, w); S is the sum of target
/// source'.
[[nodiscard]] inline Eigen::Matrix4d horn_matrix(const Eigen::Matrix3d& S) {
  const double trace = S(0, 0) + (S(1, 1) + S(2, 2));
  Eigen::Matrix4d N;
  for (int column = 0; column < 3; ++column) {
    for (int row = 0; row < 3; ++row) N(row, column) = S(row, column) + S(column, row) - (row == column ? trace : 0.0);
    const int next = (column + 1) % 3, last = (column + 2) % 3;
    N(3, column) = N(column, 3) = S(last, next) - S(next, last);
  }
  N(3, 3) = trace;
  return N;
}

}  // namespace chainslam::detail

namespace chainslam {

namespace detail {

[[nodiscard]] inline Eigen::Vector3d mean(std::span<const Eigen::Vector3d> points) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& p : points) sum += p;
  return sum / static_cast<double>(points.size());
}

}  // namespace detail

/// The similarity T, or rigid motion if not `with_scale`, for which the sum of |target_i - T source_i|^2 is least.
///
/// Always a proper rotation, also for mirrored points (Umeyama 1991); solved through Horn's quaternion matrix (1987),
/// whose largest eigenvector needs no case for it.
///
/// @param source, target  n >= 3 corresponding points, metres.
/// @returns T_target_source with scale 1 if not `with_scale`; nothing if the rotation is not determined: fewer than
/// three points, all on a line or in one place, a mirror image without a preferred axis, or a coordinate not finite.
/// @throws std::invalid_argument if the lengths differ.
[[nodiscard]] inline std::optional<Sim3d> umeyama(std::span<const Eigen::Vector3d> source,
                                                  std::span<const Eigen::Vector3d> target, bool with_scale) {
  // The gap between the two largest eigenvalues over the largest; points on a line up to 1e-6 of its length have 1e-12.
  constexpr double least_gap = 1e-12;
  if (source.size() != target.size()) throw std::invalid_argument("umeyama: source and target differ in length");
  if (source.size() < 3) return std::nullopt;
  const Eigen::Vector3d source_mean = detail::mean(source);
  const Eigen::Vector3d target_mean = detail::mean(target);
  Eigen::Matrix3d covariance = zeros<Eigen::Matrix3d>();
  double source_variance = 0;
  for (std::size_t i = 0; i < source.size(); ++i) {
    const Eigen::Vector3d p = source[i] - source_mean, q = target[i] - target_mean;
    for (int j = 0; j < 3; ++j)
      for (int k = 0; k < 3; ++k) covariance(k, j) += q[k] * p[j];
    source_variance += p.squaredNorm();
  }
  const JacobiEigen<double, 4> eigen = jacobi_eigen(detail::horn_matrix(covariance));
  // Written so that NaN is refused, too.
  if (!(eigen.values[3] - eigen.values[2] > least_gap * eigen.values[3]) || !(source_variance > 0)) return std::nullopt;
  const double* q = eigen.vectors.data() + 12;  // the last column: x, y, z, w
  const SO3d rotation = SO3d::from_quaternion(SO3d::Quaternion(q[3], q[0], q[1], q[2]));
  const double scale = with_scale ? eigen.values[3] / source_variance : 1.0;
  const Eigen::Vector3d moved = rotation * source_mean;
  const Eigen::Vector3d scaled = scale * moved;
  return Sim3d(rotation, target_mean - scaled, scale);
}

}  // namespace chainslam
