#pragma once

#include <memory>

#include "chainslam/factor_graph/factor_graph.hpp"

namespace chainslam::bench {

/// Ceres's Levenberg-Marquardt with CHOLMOD on one thread, without Ceres's headers: for Pose SE3d and SE2d.
template <class Pose>
class CeresBatch {
 public:
  /// @param graph  of priors and between factors; Ceres gets their own residuals and exact Jacobians, in the tangent
  /// space.
  explicit CeresBatch(const FactorGraph<Pose>& graph);
  ~CeresBatch();

  /// From the graph's values, ordering included, with Ceres's own tolerances.
  [[nodiscard]] Values<Pose> optimized();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace chainslam::bench
