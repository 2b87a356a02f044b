#pragma once

#include <Eigen/Core>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam::detail {

/// How far a motion, tangent [translation; rotation], moves what is `lever` metres away at most.
[[nodiscard]] inline double moved_distance(const Vector6d& motion, double lever) {
  return block_of<3, 1>(motion, 0, 0).norm() + lever * block_of<3, 1>(motion, 3, 0).norm();
}

}  // namespace chainslam::detail
