#pragma once

#include "chainslam/registration/concepts.hpp"

namespace chainslam {

/// The vector from the match to the moved point (Besl and McKay 1992). Any target will do.
struct PointToPoint {
  template <NearestNeighborSearch Target>
  [[nodiscard]] PairError<3> error(const Target& target, Index match, const Eigen::Vector3d& p_target) const {
    const auto& q = target.position(match);
    const Eigen::Vector3d q_target(static_cast<double>(q[0]), static_cast<double>(q[1]), static_cast<double>(q[2]));
    return {p_target - q_target, Eigen::Matrix3d::Identity()};
  }
};

}  // namespace chainslam
