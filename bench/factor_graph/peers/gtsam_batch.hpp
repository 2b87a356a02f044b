#pragma once

#include <memory>

#include "chainslam/factor_graph/factor_graph.hpp"

namespace chainslam::bench {

/// GTSAM's Gauss-Newton, without GTSAM's headers: for Pose SE3d and SE2d.
template <class Pose>
class GtsamBatch {
 public:
  enum class Jacobians {
    as_it_comes,  ///< `gtsam::BetweenFactor`, which leaves the logarithm's out: it does not end at the minimum
    exact
  };

  /// @param graph  of priors and between factors; what is fixed is held by a factor of its own.
  GtsamBatch(const FactorGraph<Pose>& graph, Jacobians jacobians);
  ~GtsamBatch();

  /// From the graph's values, ordering included, with GTSAM's own tolerances.
  [[nodiscard]] Values<Pose> optimized() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace chainslam::bench
