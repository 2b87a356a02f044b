#pragma once

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam {

/// Where a measurement between two keyframes came from.
enum class ClosureKind {
  direct,   ///< the search around the newest keyframe
  chained,  ///< a keyframe connected to the partner of a direct closure
  merge     ///< place recognition between two frames, which it joined
};

/// Why a candidate was refused; `accepted` if it was not.
enum class ClosureVerdict {
  accepted,
  not_converged,
  too_few_inliers,
  high_residual,
  implausible,   ///< farther from the estimate than that may be off
  low_fitness,   ///< too little of the target found again
  inconsistent,  ///< contradicts what is already connected
  unconfirmed,   ///< a merge that neither a second place nor enough of one agreed with
  reverted,      ///< of a merge that was taken back, or derived from it
  against_fixes  ///< a merge that the GNSS fixes of both sessions contradict
};

/// A measured relative pose between two keyframes that are not neighbours in time, or the record of one that was
/// refused.
struct LoopClosure {
  KeyframeId from{};  ///< j, the older keyframe, whose submap was the target
  KeyframeId to{};    ///< i, the keyframe whose scan was aligned
  SE3d T_from_to{};   ///< T_j_i = x_j^-1 x_i
  /// Of T_from_to, tangent [translation; rotation]. Zero: known to no degree, and no factor in the graph.
  SqrtInformation<6> sqrt_information = zeros<SqrtInformation<6>>();
  ClosureKind kind = ClosureKind::direct;             ///< what the measurement came from
  ClosureVerdict verdict = ClosureVerdict::accepted;  ///< whether it was accepted, and if not, why
  double mean_squared_error = 0;                      ///< m^2 over inlier correspondences (e_ij of the paper)
  /// Inliers over source points; of a merge, over target points (f^R_ij of the paper).
  double inlier_ratio = 0;
  /// Position among the map's closures of the one that led to this: a chained one's direct closure, or the merge whose
  /// recheck found a direct one. -1: none.
  Index cause = -1;

  /// Whether it is in the pose graph, if only with the weight of an outlier.
  [[nodiscard]] bool is_factor() const { return verdict != ClosureVerdict::reverted && !sqrt_information.isZero(0); }
};

}  // namespace chainslam
