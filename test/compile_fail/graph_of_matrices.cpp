// expect: FactorGraph: Group needs exp, log, adjoint and Jacobians, as in SE3d
// Variables that are matrices instead of members of a group.
#include "chainslam/factor_graph/factor_graph.hpp"

struct Pose {
  Eigen::Matrix4d matrix;
  static constexpr int dof = 6;
};

#ifdef CHAINSLAM_RIGHT
chainslam::FactorGraph<chainslam::SE3d> graph;
#else
chainslam::FactorGraph<Pose> graph;
#endif
