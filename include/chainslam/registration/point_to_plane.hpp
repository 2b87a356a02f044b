#pragma once

#include "chainslam/core/finite.hpp"
#include "chainslam/registration/concepts.hpp"

namespace chainslam {

/// The distance of the moved point from the plane through the match (Chen and Medioni 1992). The target needs normals;
/// a point without one (zero or not finite) tells nothing.
struct PointToPlane {
  template <OrientedSearch Target>
  [[nodiscard]] PairError<1> error(const Target& target, Index match, const Eigen::Vector3d& p_target) const {
    const auto& q = target.position(match);
    const auto& n = target.normal(match);
    const Eigen::Vector3d q_target(static_cast<double>(q[0]), static_cast<double>(q[1]), static_cast<double>(q[2]));
    const Eigen::Vector3d normal(static_cast<double>(n[0]), static_cast<double>(n[1]), static_cast<double>(n[2]));
    if (!is_finite(normal.squaredNorm())) return {Eigen::Matrix<double, 1, 1>::Zero(), Eigen::RowVector3d::Zero()};
    return {Eigen::Matrix<double, 1, 1>(normal.dot(p_target - q_target)), normal.transpose()};
  }
};

}  // namespace chainslam
