#pragma once

#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam {

/// Where a measurement between two keyframes came from.
enum class ClosureKind { direct, chained, merge };

/// Why a candidate was refused; `accepted` if it was not.
enum class ClosureVerdict { accepted, not_converged, too_few_inliers, high_residual, implausible };

/// A measured relative pose between two keyframes that are not neighbours in time, or the record of one that was
/// refused.
struct LoopClosure {
  KeyframeId from;                             ///< j, the older keyframe, whose submap was the target
  KeyframeId to;                               ///< i, the keyframe whose scan was aligned
  SE3d T_from_to;                              ///< T_j_i = x_j^-1 x_i
  Matrix6d covariance = Matrix6d::Identity();  ///< of T_from_to, tangent [translation; rotation]
  ClosureKind kind = ClosureKind::direct;
  ClosureVerdict verdict = ClosureVerdict::accepted;
  double mean_squared_error = 0;  ///< m^2 over inlier correspondences (e_ij of the paper)
  double inlier_ratio = 0;        ///< inliers over source points
};

}  // namespace chainslam
