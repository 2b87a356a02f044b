#pragma once

#include <Eigen/Core>

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
