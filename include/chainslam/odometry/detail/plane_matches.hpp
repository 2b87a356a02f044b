#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <span>

#include "chainslam/cloud/plane_fit.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/odometry/inertial_motion_options.hpp"
#include "chainslam/search/concepts.hpp"

namespace chainslam::detail {

/// The plane a point was matched with: {p : normal . (p - anchor) = 0}; no match if the normal is zero.
struct MatchedPlane {
  Eigen::Vector3f normal = zeros<Eigen::Vector3f>();
  Eigen::Vector3f anchor = zeros<Eigen::Vector3f>();
  Eigen::Vector3f long_side = zeros<Eigen::Vector3f>();  ///< unit, in the plane
  float long_tilt = 0;                                   ///< variance of the normal towards the long side, rad^2
  float short_tilt = 0;                                  ///< and across it
};

/// What makes neighbours a plane.
struct PlaneRule {
  double max_neighbor_distance;  ///< metres
  double max_deviation;          ///< metres
  double min_width;              ///< metres
  double least_noise;            ///< metres, of a neighbour's position
  PlaneForm form = PlaneForm::centred;
};

/// Points of one ring and one of another fit a plane exactly, and show nothing of it. The leverage of a point, its
/// diagonal entry of the regression's hat matrix, is 1 where the plane depends on that point alone.
inline constexpr double max_leverage = 0.95;

/// The points' plane of least squares as it will be used, or none if they are uneven or on one line.
template <std::size_t Count>
[[nodiscard]] MatchedPlane centred_plane(const PlaneFit& plane, const std::array<Eigen::Vector3d, Count>& points,
                                         const PlaneRule& rule) {
  if (!plane.good() || plane.eigenvalues[1] < rule.min_width * rule.min_width) return {};
  const Eigen::Vector3d across = plane.normal.cross(plane.tangent);
  const double n = static_cast<double>(Count);
  for (const Eigen::Vector3d& point : points) {
    const Eigen::Vector3d d = difference_of(point, plane.centroid);
    const double u = plane.tangent.dot(d), v = across.dot(d);
    const double leverage = (1 + u * u / plane.eigenvalues[2] + v * v / plane.eigenvalues[1]) / n;
    if (std::abs(plane.distance(point)) > rule.max_deviation || leverage > max_leverage) return {};
  }
  // Three of n numbers go into the plane, n - 3 tell the noise s^2; a side with variance l tilts by s^2 / (n l).
  const double noise = std::max(plane.eigenvalues[0] / static_cast<double>(Count - 3),
                                rule.least_noise * rule.least_noise / static_cast<double>(Count));
  return {converted<float>(plane.normal), converted<float>(plane.centroid), converted<float>(plane.tangent),
          static_cast<float>(noise / plane.eigenvalues[2]), static_cast<float>(noise / plane.eigenvalues[1])};
}

/// The least-squares solution a of a . p = -1 for points of mean m and covariance C, a = -adj(C) m / (det C + m .
/// adj(C) m), brought to unit length.
///
/// @param origin  metres, from where the anchor counts.
template <std::size_t Count>
[[nodiscard]] MatchedPlane intercept_plane(const PlaneFit& fit, const std::array<Eigen::Vector3d, Count>& points,
                                           const PlaneRule& rule, const Eigen::Vector3d& origin) {
  if (!fit.good()) return {};
  const Eigen::Vector3d &l = fit.eigenvalues, &m = fit.centroid, &u0 = fit.normal, &u2 = fit.tangent;
  const Eigen::Vector3d u1 = u2.cross(u0);
  const double a0 = l[1] * l[2] * u0.dot(m), a1 = l[0] * l[2] * u1.dot(m), a2 = l[0] * l[1] * u2.dot(m);
  Eigen::Vector3d adjugate_m;
  for (int i = 0; i < 3; ++i) adjugate_m[i] = a0 * u0[i] + a1 * u1[i] + a2 * u2[i];
  const double length = adjugate_m.norm();
  if (!(length > 0)) return {};
  const Eigen::Vector3d normal = divided(adjugate_m, -length);
  const double offset = (l[0] * l[1] * l[2] + m.dot(adjugate_m)) / length;
  for (const Eigen::Vector3d& point : points)
    if (std::abs(normal.dot(point) + offset) > rule.max_deviation) return {};
  const Eigen::Vector3d anchor = scaled(-(offset + normal.dot(origin)), normal);
  return {.normal = converted<float>(normal), .anchor = converted<float>(anchor)};
}

/// The plane through the nearest neighbours of `p`, or none if they are too few, too far or no plane.
template <std::size_t Neighbors, NearestNeighborSearch Map>
[[nodiscard]] MatchedPlane match_plane(const Map& map, const Eigen::Vector3d& p, const PlaneRule& rule) {
  using Scalar = typename Map::Scalar;
  std::array<Neighbor<Scalar>, Neighbors> found;
  const auto limit = static_cast<Scalar>(rule.max_neighbor_distance);
  if (map.knn(converted<Scalar>(p), found, limit) < static_cast<Index>(Neighbors)) return {};
  std::array<Eigen::Vector3d, Neighbors> points;
  for (std::size_t i = 0; i < Neighbors; ++i)
    points[i] = converted<double>(SearchVector<Map>(map.position(found[i].index)));
  const PlaneFit fit = fit_plane(std::span<const Eigen::Vector3d>(points));
  return rule.form == PlaneForm::centred ? centred_plane(fit, points, rule)
                                         : intercept_plane(fit, points, rule, zeros<Eigen::Vector3d>());
}

}  // namespace chainslam::detail
