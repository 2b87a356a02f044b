// expect: LinearSolver
#include "chainslam/factor_graph/batch_optimizer.hpp"

struct MySolver {
  static constexpr int block_size = 6;
};

#ifdef CHAINSLAM_RIGHT
using Solver = chainslam::BlockCholesky<6>;
#else
using Solver = MySolver;
#endif

int main() {
  chainslam::FactorGraph<chainslam::SE3d> graph;
  Solver solver;
  (void)chainslam::optimize(graph, chainslam::LevenbergMarquardt{}, solver);
}
