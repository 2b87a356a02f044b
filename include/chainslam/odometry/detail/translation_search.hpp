#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/symmetric_eigen.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/odometry/detail/plane_matches.hpp"
#include "chainslam/search/concepts.hpp"

namespace chainslam::detail {

/// Places where a scan may lie in a map, found by comparing a grid of translations (as correlative scan matching, Olson
/// 2009), for a scan whose motion is not known at all.
///
/// Registration from a guess that is metres off ends at the nearest place that looks alike: of a street's parked cars,
/// the next one. Such places lie in the directions that the planes show least, while the others come out right from any
/// guess. So the grid spans the two directions that the scan shows least; no frame need be level, and a slope is as
/// good as flat ground.
struct TranslationSearch {
  double reach = 4;           ///< metres, of the grid about its centre
  double spacing = 1;         ///< metres, of the grid; a place found is off by less
  std::size_t points = 300;   ///< of the scan that are compared, about
  std::size_t max_found = 3;  ///< best places that are returned

  /// For a body that may have moved by up to 45 m/s for some seconds; by 7 m at most, as odometry believes no more.
  [[nodiscard]] static TranslationSearch after(double interval) {
    constexpr double max_speed = 45, max_reach = 7;
    return {.reach = std::min(max_reach, max_speed * interval)};
  }
  /// Whether a match is so good that no other place needs to be compared with it. Set on pairs of scans of KITTI 00 and
  /// nuScenes: of 222 registrations that ended at a wrong place none had more than 0.27 of its points' weight, nor more
  /// than at the right place.
  [[nodiscard]] static bool needless(double weight, std::size_t points) {
    constexpr double clear = 0.5;
    return weight >= clear * static_cast<double>(points);
  }

  /// @param scan    n points, body frame.
  /// @param rule    makes planes of neighbours in the map.
  /// @param guess   T_map_body whose rotation is right but for a few degrees, and whose translation is in the direction
  ///                that the planes show best, usually across the ground.
  /// @param centre  of the grid, in the map.
  /// @returns T_map_body of the best places, at least 1.5 spacings apart, best first.
  template <Cloud Scan, NearestNeighborSearch Map, Executor E>
  [[nodiscard]] std::vector<SE3d> operator()(const Scan& scan, const Map& map, const PlaneRule& rule, const SE3d& guess,
                                             const Eigen::Vector3d& centre, const E& executor) const;

 private:
  struct Place {
    SE3d T_map_body;
    double score = 0;
  };

  /// The translations of the grid in the plane of the first two of `axes`.
  [[nodiscard]] std::vector<Place> grid(const SE3d& guess, const Eigen::Vector3d& centre,
                                        const Eigen::Matrix3d& axes) const {
    const Eigen::Vector3d u = block_of<3, 1>(axes, 0, 0), v = block_of<3, 1>(axes, 0, 1);
    const Eigen::Vector3d off = difference_of(centre, guess.translation());
    const double to_u = u.dot(off), to_v = v.dot(off);
    const int steps = static_cast<int>(std::ceil(reach / spacing));
    std::vector<Place> places;
    for (int i = -steps; i <= steps; ++i)
      for (int j = -steps; j <= steps; ++j) {
        if (i * i + j * j > steps * steps) continue;
        const Eigen::Vector3d moved = sum_of(scaled(to_u + i * spacing, u), scaled(to_v + j * spacing, v));
        places.push_back({SE3d(guess.rotation(), sum_of(guess.translation(), moved))});
      }
    return places;
  }
  [[nodiscard]] std::vector<SE3d> best(const std::vector<Place>& places) const {
    std::vector<SE3d> found;
    while (found.size() < max_found) {
      const Place* highest = nullptr;
      for (const Place& place : places)
        if ((highest == nullptr || place.score > highest->score) && !near(place, found)) highest = &place;
      if (highest == nullptr) break;
      found.push_back(highest->T_map_body);
    }
    return found;
  }
  [[nodiscard]] bool near(const Place& place, const std::vector<SE3d>& found) const {
    for (const SE3d& T : found)
      if (difference_of(T.translation(), place.T_map_body.translation()).norm() < 1.5 * spacing) return true;
    return false;
  }
};

template <Cloud Scan, NearestNeighborSearch Map, Executor E>
std::vector<SE3d> TranslationSearch::operator()(const Scan& scan, const Map& map, const PlaneRule& rule,
                                                const SE3d& guess, const Eigen::Vector3d& centre,
                                                const E& executor) const {
  constexpr std::size_t neighbors = 5;
  std::vector<Eigen::Vector3d> some;
  const std::size_t stride = std::max<std::size_t>(1, cloud_size(scan) / points);
  for (std::size_t i = 0; i < cloud_size(scan); i += stride) some.push_back(position(scan, i));

  // A point's distance from its plane weighs as by Geman and McClure.
  const double unit = 0.5 * spacing;
  const auto each_plane = [&](const SE3d& T, auto&& take) {
    const Eigen::Matrix3d R = T.rotation().matrix();
    for (const Eigen::Vector3d& p : some) {
      const Eigen::Vector3d moved = sum_of(product(R, p), T.translation());
      const MatchedPlane plane = match_plane<neighbors>(map, moved, rule);
      const Eigen::Vector3d normal = converted<double>(plane.normal);
      if (normal.squaredNorm() == 0) continue;
      const double distance = normal.dot(difference_of(moved, converted<double>(plane.anchor)));
      const double root = 1 + distance * distance / (unit * unit);
      take(normal, 1 / (root * root));
    }
  };
  Eigen::Matrix3d shown = zeros<Eigen::Matrix3d>();
  each_plane(guess, [&](const Eigen::Vector3d& n, double weight) {
    for (int j = 0; j < 3; ++j)
      for (int i = 0; i < 3; ++i) shown(i, j) += weight * n[i] * n[j];
  });
  const JacobiEigen<double, 3> eigen = jacobi_eigen(shown);
  std::vector<Place> places = grid(guess, centre, eigen.vectors);
  executor.for_chunks(to_index(places.size()), 1, [&](Index begin, Index end) {
    for (auto i = static_cast<std::size_t>(begin); i < static_cast<std::size_t>(end); ++i)
      each_plane(places[i].T_map_body, [&](const Eigen::Vector3d&, double weight) { places[i].score += weight; });
  });
  return best(places);
}

}  // namespace chainslam::detail
