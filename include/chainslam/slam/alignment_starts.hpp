#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "chainslam/core/jacobi_eigen.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/so3.hpp"

namespace chainslam {

/// Where an alignment starts again after it was refused where the graph has the scan.
///
/// Along the direction in which the graph knows the relative position least, up to two standard deviations. After
/// several searches in a row in which nothing was accepted, although keyframes are near, odometry may have failed
/// unnoticed: then in all horizontal directions, each search at another distance.
struct AlignmentStarts {
  double spacing = 3.0;        ///< metres between two starts: an alignment reaches about so far
  double max_distance = 15.0;  ///< metres from where the graph has the scan; 0: there alone
  Index patience = 2;          ///< searches in a row without an accepted closure

  /// Standard deviation in the direction that is known least, metres.
  /// @param covariance  of T_from_to, tangent [translation; rotation].
  [[nodiscard]] static double deviation(const Matrix6d& covariance) {
    return std::sqrt(std::max(translation_eigen(covariance).values[2], 0.0));
  }

  /// @param R_map_body  attitude of the scan that is aligned.
  /// @param refused     searches in a row without an accepted closure, with this one.
  /// @returns offsets from the pose by the graph, in the scan's own frame, metres; none if there is no reason.
  [[nodiscard]] [[gnu::cold]] std::vector<Eigen::Vector3d> operator()(const Matrix6d& covariance,
                                                                      const SO3d& R_map_body, Index refused) const {
    std::vector<Eigen::Vector3d> offsets;
    const JacobiEigen<double, 3> eigen = translation_eigen(covariance);
    const double reach = std::min(max_distance, 2 * std::sqrt(std::max(eigen.values[2], 0.0)));
    for (double distance = spacing; distance <= reach; distance += spacing)
      for (const double signed_distance : {distance, -distance})
        offsets.push_back(scaled(signed_distance, block_of<3, 1>(eigen.vectors, 0, 2)));
    const Index rings = static_cast<Index>(max_distance / spacing);
    if (refused <= patience || rings < 1) return offsets;
    constexpr int directions = 8;
    const double radius = spacing * (1 + (refused - patience - 1) % rings);
    const SO3d R_body_map = R_map_body.inverse();
    for (int k = 0; k < directions; ++k) {
      const double angle = 2 * std::numbers::pi * k / directions;
      offsets.push_back(R_body_map * Eigen::Vector3d(radius * std::cos(angle), radius * std::sin(angle), 0.0));
    }
    return offsets;
  }

 private:
  [[nodiscard]] static JacobiEigen<double, 3> translation_eigen(const Matrix6d& covariance) {
    return jacobi_eigen(Eigen::Matrix3d(block_of<3, 3>(covariance, 0, 0)));
  }
};

}  // namespace chainslam
