#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>

namespace chainslam {

/// Eigenvalues, ascending, and unit eigenvectors (columns, right-handed) of a symmetric 3x3 matrix.
struct SymmetricEigen3 {
  Eigen::Vector3d values;
  Eigen::Matrix3d vectors;
};

namespace detail {

/// The eigenvalue farthest from the two others, of a matrix with trace zero and squared norm 6 p^2. It is p times the
/// outermost root of x^3 - 3 x = det, which lies between sqrt(3) and 2 and is well conditioned there: a polynomial good
/// to 5e-5 starts Newton's method, two steps of which reach the last bit. No library function, the same bits
/// everywhere.
[[nodiscard]] inline double isolated_eigenvalue(const Eigen::Matrix3d& m, double p) {
  const double inverse = 1.0 / p;
  const double a = m(0, 0) * inverse, b = m(1, 1) * inverse, c = m(2, 2) * inverse;
  const double d = m(1, 0) * inverse, e = m(2, 0) * inverse, f = m(2, 1) * inverse;
  const double half_det = 0.5 * (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e));
  const double h = std::min(std::abs(half_det), 1.0);
  double x = std::numbers::sqrt3 + h * (1.0 / 3.0 + h * (-0.0935 + h * (0.03658 - 0.00846 * h)));
  for (int step = 0; step < 2; ++step) x = (2.0 * x * x * x + 2.0 * h) / (3.0 * x * x - 3.0);
  return half_det >= 0 ? p * x : -p * x;
}

/// The null direction of a symmetric matrix of rank two: the longest cross product of two of its rows.
[[nodiscard]] inline Eigen::Vector3d null_direction(const Eigen::Matrix3d& m) {
  const Eigen::Vector3d r0 = m.col(0), r1 = m.col(1), r2 = m.col(2);
  const Eigen::Vector3d c01 = r0.cross(r1), c12 = r1.cross(r2), c20 = r2.cross(r0);
  const double n01 = c01.squaredNorm(), n12 = c12.squaredNorm(), n20 = c20.squaredNorm();
  if (n01 >= n12 && n01 >= n20) return c01 * (1.0 / std::sqrt(n01));
  return n12 >= n20 ? Eigen::Vector3d(c12 * (1.0 / std::sqrt(n12))) : Eigen::Vector3d(c20 * (1.0 / std::sqrt(n20)));
}

}  // namespace detail

/// A fixed number of operations; errors of the order of 1e-16 times the largest eigenvalue, also for equal eigenvalues.
///
/// The eigenvector of the isolated eigenvalue comes first, then one Jacobi rotation in the plane across it gives the
/// other two, so that a nearly double eigenvalue does no harm (Eberly, A robust eigensolver for 3x3 symmetric
/// matrices).
/// @param matrix  finite; only the lower triangle is read.
[[nodiscard]] inline SymmetricEigen3 symmetric_eigen(const Eigen::Matrix3d& matrix) {
  const Eigen::Matrix3d full = matrix.selfadjointView<Eigen::Lower>();
  const double scale = full.cwiseAbs().maxCoeff();
  if (!(scale > 4 * std::numeric_limits<double>::min())) return {Eigen::Vector3d::Zero(), Eigen::Matrix3d::Identity()};

  const Eigen::Matrix3d scaled = full * (1.0 / scale);
  const double mean = scaled.trace() / 3.0;
  const Eigen::Matrix3d shifted = scaled - mean * Eigen::Matrix3d::Identity();
  const double p = std::sqrt(shifted.squaredNorm() / 6.0);
  if (!(p > 1e-16)) return {Eigen::Vector3d::Constant(mean * scale), Eigen::Matrix3d::Identity()};

  const double isolated = detail::isolated_eigenvalue(shifted, p);
  const Eigen::Vector3d v = detail::null_direction(shifted - isolated * Eigen::Matrix3d::Identity());
  const Eigen::Vector3d u = v.unitOrthogonal();
  const Eigen::Vector3d w = v.cross(u);

  // The 2x2 matrix [a c; c b] of the map in the basis (u, w), made diagonal by one Jacobi rotation of tangent t.
  const Eigen::Vector3d scaled_u = scaled * u, scaled_w = scaled * w;
  const double a = u.dot(scaled_u), b = w.dot(scaled_w), c = u.dot(scaled_w);
  const double difference = b - a, root = std::sqrt(difference * difference + 4.0 * c * c);
  const double t = root > 0 ? 2.0 * c / (difference + (difference >= 0 ? root : -root)) : 0.0;
  const double cosine = 1.0 / std::sqrt(1.0 + t * t), sine = t * cosine;
  Eigen::Vector3d minor = cosine * u - sine * w, major = sine * u + cosine * w;
  double low = a - t * c, high = b + t * c;
  if (low > high) {
    std::swap(low, high);
    minor.swap(major);
  }
  const double alone = v.dot(scaled * v);

  SymmetricEigen3 result;
  if (isolated < 0) {
    result.values = Eigen::Vector3d(alone, low, high) * scale;
    result.vectors << v, minor, major;
  } else {
    result.values = Eigen::Vector3d(low, high, alone) * scale;
    result.vectors << minor, major, v;
  }
  if (result.vectors.determinant() < 0) result.vectors.col(1) *= -1.0;
  return result;
}

}  // namespace chainslam
