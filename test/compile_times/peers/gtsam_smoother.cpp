// A pose graph that grows, by GTSAM.
#include <gtsam/geometry/Pose3.h>
#include <gtsam/nonlinear/ISAM2.h>
#include <gtsam/slam/BetweenFactor.h>
#include <gtsam/slam/PriorFactor.h>

int main() {
  using namespace gtsam;
  const auto noise = noiseModel::Isotropic::Sigma(6, 0.1);
  NonlinearFactorGraph graph;
  graph.addPrior(0, Pose3(), noise);
  graph.emplace_shared<BetweenFactor<Pose3>>(0, 1, Pose3(), noise);
  Values values;
  values.insert(0, Pose3());
  values.insert(1, Pose3());
  ISAM2 smoother;
  return smoother.update(graph, values).getVariablesRelinearized() > 0 ? 0 : 1;
}
