#pragma once

#include "chainslam/core/executor.hpp"
#include "chainslam/registration/icp.hpp"

namespace chainslam {

/// Two registrations in a row: one that reaches far finds the place, one that looks near settles the pose.
///
/// The result is the second's; where the first finds no overlap, it is the first's.
template <class Coarse = Icp<PointToPlane, GemanMcClure>, class Fine = Coarse>
struct CoarseToFine {
  Coarse coarse{.max_iterations = 20, .max_distance = 5.0, .kernel = {.width = 1.0}};
  Fine fine{.max_iterations = 50, .max_distance = 2.0, .kernel = {.width = 0.3}};

  template <Cloud Source, NearestNeighborSearch Target, Executor Exec = Serial>
  [[nodiscard]] AlignResult align(const Source& source, const Target& target, const SE3d& guess,
                                  const Exec& executor = {}) const {
    const AlignResult first = coarse.align(source, target, guess, executor);
    if (first.status == AlignStatus::no_overlap || first.status == AlignStatus::too_few_points) return first;
    return fine.align(source, target, first.T_target_source, executor);
  }
};

}  // namespace chainslam
