#pragma once

#include <Eigen/Core>
#include <algorithm>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/symmetric_eigen.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam {

enum class PlaneStatus {
  good,
  too_few_points,  ///< fewer than three
  not_finite,      ///< a coordinate is NaN or infinite
  degenerate,      ///< all points on one line, or in one place: no normal is defined
};

/// The plane {p : normal . p + offset = 0} through a set of points, and how well it describes them.
struct PlaneFit {
  PlaneStatus status = PlaneStatus::too_few_points;       ///< whether there is a plane, and if not, why
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();      ///< unit length, sign not defined
  double offset = 0;                                      ///< metres
  Eigen::Vector3d centroid = Eigen::Vector3d::Zero();     ///< metres
  Eigen::Vector3d eigenvalues = Eigen::Vector3d::Zero();  ///< of the covariance, ascending, m^2
  Eigen::Vector3d tangent = Eigen::Vector3d::UnitX();     ///< unit, direction of the largest eigenvalue

  [[nodiscard]] bool good() const { return status == PlaneStatus::good; }  ///< whether there is a plane
  /// Signed distance of a point, metres.
  [[nodiscard]] double distance(const Eigen::Vector3d& p) const { return normal.dot(difference_of(p, centroid)); }
  /// (l1 - l0) / l2 in [0, 1]: 1 for a round disc, 0 for a line or a ball (Weinmann et al. 2015).
  [[nodiscard]] double planarity() const {
    return eigenvalues[2] > 0 ? (eigenvalues[1] - eigenvalues[0]) / eigenvalues[2] : 0.0;
  }
  /// l0 / (l0 + l1 + l2) in [0, 1/3], the surface variation (Pauly et al. 2002).
  [[nodiscard]] double curvature() const {
    const double all = eigenvalues[0] + eigenvalues[1] + eigenvalues[2];
    return all > 0 ? eigenvalues[0] / all : 0.0;
  }
};

/// The plane of least squares through points with this mean and this covariance (m^2; the sum over n, divided by n).
[[nodiscard]] inline PlaneFit fit_plane(const Eigen::Vector3d& mean, const Eigen::Matrix3d& covariance) {
  // A second axis 1e-4 as long as the first is a line: no more than the rounding of float coordinates.
  constexpr double line_ratio = 1e-8;
  PlaneFit fit;
  if (!is_finite(mean) || !is_finite(covariance)) {
    fit.status = PlaneStatus::not_finite;
    return fit;
  }
  const SymmetricEigen3 eigen = symmetric_eigen(covariance);
  fit.centroid = mean;
  for (int i = 0; i < 3; ++i) fit.eigenvalues[i] = std::max(eigen.values[i], 0.0);
  fit.normal = block_of<3, 1>(eigen.vectors, 0, 0);
  fit.tangent = block_of<3, 1>(eigen.vectors, 0, 2);
  fit.offset = -fit.normal.dot(mean);
  fit.status = fit.eigenvalues[1] > line_ratio * fit.eigenvalues[2] ? PlaneStatus::good : PlaneStatus::degenerate;
  return fit;
}

/// The plane of least squares through the points: sums are taken about the mean, in double, so that neither the
/// distance from the origin nor a plane through the origin matters.
///
/// @param points  n >= 3 points, metres; a vector, a span, the columns of a 3 x n matrix, or any other cloud.
/// @returns the plane, or in `status` why there is none; never throws.
template <Cloud Points>
[[nodiscard]] PlaneFit fit_plane(const Points& points) {
  const std::size_t count = cloud_size(points);
  if (count < 3) return {};
  const double inverse_count = 1.0 / static_cast<double>(count);
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < count; ++i) mean += position(points, i);
  mean = scaled(inverse_count, mean);
  double xx = 0, xy = 0, xz = 0, yy = 0, yz = 0, zz = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const Eigen::Vector3d d = difference_of(position(points, i), mean);
    xx += d[0] * d[0];
    xy += d[0] * d[1];
    xz += d[0] * d[2];
    yy += d[1] * d[1];
    yz += d[1] * d[2];
    zz += d[2] * d[2];
  }
  return fit_plane(mean, symmetric_matrix(xx * inverse_count, xy * inverse_count, xz * inverse_count,
                                          yy * inverse_count, yz * inverse_count, zz * inverse_count));
}

}  // namespace chainslam
