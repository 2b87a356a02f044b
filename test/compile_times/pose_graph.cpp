// A pose graph, optimized as a whole.
#include <chainslam/factor_graph/batch_optimizer.hpp>
#include <chainslam/factor_graph/factors.hpp>

int main() {
  using namespace chainslam;
  PoseGraph graph;
  const auto noise = NoiseModel<6>::from_sigma(0.1);
  graph.add_value(SE3d());
  graph.add_value(SE3d());
  graph.add(PriorFactor<SE3d>{0, SE3d(), noise.sqrt_information()});
  graph.add(BetweenFactor<SE3d>{0, 1, SE3d(), noise.sqrt_information()});
  return optimize(graph).ok() ? 0 : 1;
}
