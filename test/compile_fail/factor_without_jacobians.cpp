// expect: FactorGraph: a factor needs keys(), residual(values) and linearize(values)
// expect: see chainslam/factor_graph/values.hpp
// A factor of the user's own that lacks its Jacobians.
#include "chainslam/factor_graph/factor_graph.hpp"

struct HeightFactor {
  using Value = chainslam::SE3d;
};

#ifdef CHAINSLAM_RIGHT
chainslam::FactorGraph<chainslam::SE3d> graph;
#else
chainslam::FactorGraph<chainslam::SE3d, HeightFactor> graph;
#endif
