#pragma once

#include <doctest/doctest.h>

#include "chainslam/factor_graph/incremental_smoother.hpp"
#include "support/street_walk.hpp"

namespace chainslam::test {

/// What feeding a walk keyframe by keyframe takes in all.
struct WalkWork {
  double relinearized = 0.0;  ///< factors
  double reordered = 0.0;     ///< variables, as the next two
  double refactorized = 0.0;
  double substituted = 0.0;
  double multiplications = 0.0;
  double cost_over_optimum = 0.0;
};

inline WalkWork work_of(const StreetWalkOptions& options, const SmootherOptions& smoother_options = {}) {
  StreetWalk walk(options);
  IncrementalSmoother<SE3d> smoother(smoother_options);
  WalkWork sum;
  while (!walk.done()) {
    const StreetWalk::Step step = walk.next();
    const Key key = smoother.size();
    smoother.add_value(step.starts ? step.motion : smoother[key - 1] * step.motion);
    if (step.starts) smoother.add_prior(key, step.motion, StreetWalk::start_noise());
    if (!step.starts) smoother.add_between(key - 1, key, step.motion, StreetWalk::odometry_noise());
    for (const auto& closure : step.closures)
      smoother.add_between(closure.from, key, closure.T_from_to, StreetWalk::closure_noise());
    const UpdateReport report = smoother.update();
    REQUIRE(report.ok());
    sum.relinearized += report.relinearized;
    sum.reordered += report.work.reordered;
    sum.refactorized += report.work.refactorized;
    sum.substituted += report.work.substituted;
    sum.multiplications += report.work.multiplications;
  }
  const double cost = smoother.cost();
  REQUIRE(smoother.converge().ok());
  sum.cost_over_optimum = cost / smoother.cost();
  return sum;
}

}  // namespace chainslam::test
