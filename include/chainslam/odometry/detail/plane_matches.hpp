#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <span>
#include <vector>

#include "chainslam/cloud/plane_fit.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
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

inline constexpr Index scan_grain = 512;  ///< points a chunk

/// A point's neighbours in the map when they were last asked for; none if there were fewer than `Neighbors`.
template <class Scalar, std::size_t Neighbors>
struct FormerNeighbors {
  std::array<Neighbor<Scalar>, Neighbors> found;
  bool any = false;
};

/// Finds the neighbours of `p`, sooner where the map can start from those of a place nearby. False if there are fewer.
template <std::size_t Neighbors, NearestNeighborSearch Map>
[[nodiscard]] bool find_neighbors(const Map& map, const Eigen::Matrix<typename Map::Scalar, 3, 1>& p,
                                  typename Map::Scalar max_distance,
                                  FormerNeighbors<typename Map::Scalar, Neighbors>& neighbors) {
  const std::span found(neighbors.found);
  const auto search = [&] {
    if constexpr (SeededSearch<Map>)
      if (neighbors.any) return map.knn(p, found, max_distance, found);
    return map.knn(p, found, max_distance);
  };
  return neighbors.any = search() == static_cast<Index>(Neighbors);
}

/// The points' plane of least squares as it will be used, or none if they are uneven or on one line.
template <std::size_t Count>
[[nodiscard]] MatchedPlane centred_plane(const PlaneFit& plane, const std::array<Eigen::Vector3d, Count>& points,
                                         const PlaneRule& rule) {
  if (!plane.good() || plane.eigenvalues[1] < rule.min_width * rule.min_width) return {};
  // Points of one ring and a single one beside it make an exact plane of nothing. The leverage of a point, its diagonal
  // entry of the regression's hat matrix, is 1 where the plane hangs on that point alone.
  constexpr double max_leverage = 0.95;
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
template <std::size_t Count>
[[nodiscard]] MatchedPlane intercept_plane(const PlaneFit& fit, const std::array<Eigen::Vector3d, Count>& points,
                                           const PlaneRule& rule) {
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
  const Eigen::Vector3d anchor = scaled(-offset, normal);
  return {.normal = converted<float>(normal), .anchor = converted<float>(anchor)};
}

/// The plane through the nearest neighbours of `p`, or none if they are too few, too far or no plane.
///
/// @param former  the plane found with what `neighbors` holds: it stands as long as they stay the same.
template <std::size_t Neighbors, NearestNeighborSearch Map>
[[nodiscard]] MatchedPlane match_plane(const Map& map, const Eigen::Vector3d& p, const PlaneRule& rule,
                                       FormerNeighbors<typename Map::Scalar, Neighbors>& neighbors,
                                       const MatchedPlane& former) {
  using Scalar = typename Map::Scalar;
  const auto before = neighbors;
  if (!find_neighbors(map, converted<Scalar>(p), static_cast<Scalar>(rule.max_neighbor_distance), neighbors)) return {};
  if (before.any && std::equal(before.found.begin(), before.found.end(), neighbors.found.begin(),
                               [](const Neighbor<Scalar>& a, const Neighbor<Scalar>& b) { return a.index == b.index; }))
    return former;
  std::array<Eigen::Vector3d, Neighbors> points;
  for (std::size_t i = 0; i < Neighbors; ++i)
    points[i] = converted<double>(SearchVector<Map>(map.position(neighbors.found[i].index)));
  const PlaneFit fit = fit_plane(std::span<const Eigen::Vector3d>(points));
  return rule.form == PlaneForm::centred ? centred_plane(fit, points, rule) : intercept_plane(fit, points, rule);
}

/// Matches all points of a scan, lying at T_map_body.
///
/// @param neighbors, planes  of the scan's points, kept from matching to matching while neither scan nor map changes.
template <std::size_t Neighbors, Cloud Scan, NearestNeighborSearch Map, Executor E>
void match_planes(const Scan& scan, const Map& map, const SE3d& T_map_body, const PlaneRule& rule,
                  std::vector<FormerNeighbors<typename Map::Scalar, Neighbors>>& neighbors,
                  std::vector<MatchedPlane>& planes, const E& executor) {
  const Eigen::Matrix3d R = T_map_body.rotation().matrix();
  const Eigen::Vector3d& t = T_map_body.translation();
  planes.resize(cloud_size(scan));
  neighbors.resize(planes.size());
  executor.for_chunks(to_index(planes.size()), scan_grain, [&](Index begin, Index end) {
    for (auto i = static_cast<std::size_t>(begin); i < static_cast<std::size_t>(end); ++i)
      planes[i] = match_plane<Neighbors>(map, sum_of(product(R, position(scan, i)), t), rule, neighbors[i], planes[i]);
  });
}

/// Sums over matches for one Gauss-Newton step on the pose; tangent [translation; rotation].
struct PlaneEquations {
  Matrix6d hessian = zeros<Matrix6d>();   ///< sum w J J^T
  Vector6d gradient = zeros<Vector6d>();  ///< sum w J r
  double weight = 0;                      ///< sum w
  double squared_residuals = 0;           ///< sum w r^2, m^2
  double squared_ranges = 0;              ///< sum w |p|^2, m^2
  Matrix6d noise = zeros<Matrix6d>();     ///< the part of the Hessian to be expected from the normals' noise alone
  Index matches = 0;

  /// Adds the products of one match: its row of J with weight w to the Hessian, what its normal's noise adds to that
  /// row to the noise.
  void add_products(const Vector6d& row, double w, const Vector6d& along, double w_along, const Vector6d& across,
                    double w_across) {
    using Pair = double __attribute__((vector_size(2 * sizeof(double))));  // a SIMD register at any optimization
    const Pair r[3]{{row[0], row[1]}, {row[2], row[3]}, {row[4], row[5]}};
    const Pair u[3]{{along[0], along[1]}, {along[2], along[3]}, {along[4], along[5]}};
    const Pair v[3]{{across[0], across[1]}, {across[2], across[3]}, {across[4], across[5]}};
    double *H = hessian.data(), *N = noise.data();
    const auto add = [](double* to, const Pair& summand) {
      Pair sum;
      std::memcpy(&sum, to, sizeof sum);
      sum += summand;
      std::memcpy(to, &sum, sizeof sum);
    };
#pragma GCC unroll 6
    for (int j = 0; j < 6; ++j) {
      const double w_r = w * row[j], w_u = w_along * along[j], w_v = w_across * across[j];
#pragma GCC unroll 3
      for (int i = 0; i < 3; ++i) {
        add(H + 6 * j + 2 * i, r[i] * w_r);
        add(N + 6 * j + 2 * i, u[i] * w_u + v[i] * w_v);
      }
    }
  }

  PlaneEquations& operator+=(const PlaneEquations& other) {
    for (int i = 0; i < 36; ++i) hessian.data()[i] += other.hessian.data()[i];
    for (int i = 0; i < 36; ++i) noise.data()[i] += other.noise.data()[i];
    for (int i = 0; i < 6; ++i) gradient[i] += other.gradient[i];
    weight += other.weight;
    squared_residuals += other.squared_residuals;
    squared_ranges += other.squared_ranges;
    matches += other.matches;
    return *this;
  }
};

/// @param gate     `double gate(double range)`: largest residual that counts, metres.
/// @param weight   `double weight(double squared_residual)`.
/// The residual is r = n . (R p + t - a); moving the pose by exp([v; w]) on the right changes it by m . v + (p x m) . w
/// with m = R^T n.
template <Cloud Scan, Executor E, class Gate, class Weight>
[[nodiscard]] PlaneEquations plane_equations(const Scan& scan, const std::vector<MatchedPlane>& planes,
                                             const SE3d& T_map_body, Gate&& gate, Weight&& weight, const E& executor) {
  const Eigen::Matrix3d R = T_map_body.rotation().matrix(), R_transposed = transposed(R);
  const Eigen::Vector3d& t = T_map_body.translation();
  const auto chunk = [&](Index begin, Index end) {
    PlaneEquations sum;
    for (auto i = static_cast<std::size_t>(begin); i < static_cast<std::size_t>(end); ++i) {
      const Eigen::Vector3d n = converted<double>(planes[i].normal);
      if (n.squaredNorm() == 0) continue;
      const Eigen::Vector3d p = position(scan, i);
      const Eigen::Vector3d anchor = converted<double>(planes[i].anchor);
      const Eigen::Vector3d moved = sum_of(product(R, p), t);
      const double residual = n.dot(difference_of(moved, anchor));
      const double squared_range = p.squaredNorm();
      if (std::abs(residual) > gate(std::sqrt(squared_range))) continue;
      const double w = weight(residual * residual);
      // What a change of the pose does to a distance along `direction` (map frame).
      const auto row_along = [&](const Eigen::Vector3d& direction) {
        const Eigen::Vector3d m = product(R_transposed, direction), turned = p.cross(m);
        Vector6d row;
        for (int k = 0; k < 3; ++k) row[k] = m[k], row[3 + k] = turned[k];
        return row;
      };
      const Vector6d row = row_along(n);
      const Eigen::Vector3d side = converted<double>(planes[i].long_side);
      const Vector6d along = row_along(side);
      const Vector6d across = row_along(n.cross(side));
      sum.add_products(row, w, along, w * static_cast<double>(planes[i].long_tilt), across,
                       w * static_cast<double>(planes[i].short_tilt));
      for (int k = 0; k < 6; ++k) sum.gradient[k] += w * residual * row[k];
      sum.weight += w;
      sum.squared_residuals += w * residual * residual;
      sum.squared_ranges += w * squared_range;
      ++sum.matches;
    }
    return sum;
  };
  const auto add = [](PlaneEquations left, const PlaneEquations& right) { return left += right; };
  return reduce_chunks(executor, to_index(planes.size()), scan_grain, PlaneEquations{}, chunk, add);
}

}  // namespace chainslam::detail
