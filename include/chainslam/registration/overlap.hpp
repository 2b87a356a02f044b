#pragma once

#include <Eigen/Core>
#include <cmath>
#include <span>
#include <stdexcept>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/finite.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/search/concepts.hpp"

namespace chainslam {

/// How much of two clouds lies together at a pose.
struct Overlap {
  Index inliers = 0;           ///< source points whose nearest target point is near enough
  double share_of_source = 0;  ///< inliers over finite source points, in [0, 1]
  double share_of_target = 0;  ///< inliers over target points; above 1 if the source is that much denser
  double rmse = 0;             ///< of the inliers' distances, metres
};

/// Counts the source points that T_target_source brings to within `max_distance`, metres, of a target point.
///
/// @param source  points in the source's frame; NaN and infinite points are skipped.
/// @param target  search over points in the target's frame.
/// @returns the same to the bit for any executor.
/// @throws std::invalid_argument if `max_distance` is not positive or the pose is not finite.
template <Cloud Source, NearestNeighborSearch Target, Executor Exec = Serial>
[[nodiscard]] Overlap measure_overlap(const Source& source, const Target& target, const SE3d& T_target_source,
                                      double max_distance, const Exec& executor = {}) {
  using Scalar = typename Target::Scalar;
  struct Sums {
    Index points = 0, inliers = 0;
    double squared_distance = 0;
  };
  if (!(max_distance > 0)) throw std::invalid_argument("measure_overlap: max_distance must be positive");
  const Eigen::Matrix3d R = T_target_source.rotation().matrix();
  if (!is_finite(T_target_source.translation()) || !is_finite(R))
    throw std::invalid_argument("measure_overlap: the pose is not finite");
  constexpr Index grain = 512;
  const Eigen::Vector3d t = T_target_source.translation();
  const auto sum_chunk = [&](Index begin, Index end) {
    Sums sums;
    for (auto i = static_cast<std::size_t>(begin); i < static_cast<std::size_t>(end); ++i) {
      const Eigen::Vector3d p = product(R, position(source, i)) + t;
      if (!is_finite(p)) continue;
      ++sums.points;
      Neighbor<Scalar> nearest;
      const Eigen::Matrix<Scalar, 3, 1> query(static_cast<Scalar>(p[0]), static_cast<Scalar>(p[1]),
                                              static_cast<Scalar>(p[2]));
      if (target.knn(query, {&nearest, 1}, static_cast<Scalar>(max_distance)) == 0) continue;
      ++sums.inliers;
      sums.squared_distance += static_cast<double>(nearest.squared_distance);
    }
    return sums;
  };
  const Sums all = reduce_chunks(executor, to_index(cloud_size(source), "cloud"), grain, Sums{}, sum_chunk,
                                 [](const Sums& left, const Sums& right) {
                                   return Sums{left.points + right.points, left.inliers + right.inliers,
                                               left.squared_distance + right.squared_distance};
                                 });
  if (all.inliers == 0) return {};
  const auto inliers = static_cast<double>(all.inliers);
  return {.inliers = all.inliers,
          .share_of_source = inliers / static_cast<double>(all.points),
          .share_of_target = inliers / static_cast<double>(target.size()),
          .rmse = std::sqrt(all.squared_distance / inliers)};
}

}  // namespace chainslam
