// A pose graph in the plane with a factor of one's own: distances to a beacon, whose position is a variable, too.
// Usage: example_pose_graph_with_own_factor [GRAPH.g2o [FROM TO METRES]...]: adds measured distances between vertices.
#include <chainslam/factor_graph/batch_optimizer.hpp>
#include <chainslam/factor_graph/marginals.hpp>
#include <chainslam/io/g2o.hpp>
#include <cstdio>

#include "generated/beacon_drive.hpp"

using namespace chainslam;

/// A measured distance between the positions of two variables.
struct DistanceFactor {
  using Value = SE2d;
  static constexpr std::size_t arity = 2;
  static constexpr int rows = 1;
  Key from = 0, to = 0;
  double distance = 0, sigma = 0.05;  ///< metres

  std::array<Key, 2> keys() const { return {from, to}; }
  Eigen::Matrix<double, 1, 1> residual(const Values<SE2d>& values) const {
    const double length = (values[to].translation() - values[from].translation()).norm();
    return Eigen::Matrix<double, 1, 1>((length - distance) / sigma);
  }
  LinearizedFactor<1, 3, 2> linearize(const Values<SE2d>& values) const {
    const Eigen::Vector2d along = (values[to].translation() - values[from].translation()).normalized() / sigma;
    LinearizedFactor<1, 3, 2> result{residual(values), {}};
    result.jacobians[0] << -along.transpose() * values[from].rotation().matrix(), 0;  // a right perturbation: t + R d
    result.jacobians[1] << along.transpose() * values[to].rotation().matrix(), 0;
    return result;
  }
};
static_assert(Factor<DistanceFactor>);

int main(int count, char** arguments) try {
  FactorGraph<SE2d, DistanceFactor> graph;
  const G2oRecords<SE2d> records = count > 1 ? read_g2o(arguments[1]).planar : generated::beacon_drive();
  std::map<std::int64_t, Key> keys;
  for (const auto& vertex : records.vertices) keys[vertex.id] = graph.add_value(vertex.pose);
  for (const auto& [from, to, measurement, information] : records.edges)
    graph.add_between(keys.at(from), keys.at(to), measurement, NoiseModel<3>::from_information(information));
  graph.set_fixed(0);
  for (int i = 2; i + 2 < count; i += 3)
    graph.add(DistanceFactor{keys.at(std::stoll(arguments[i])), keys.at(std::stoll(arguments[i + 1])),
                             std::stod(arguments[i + 2])});
  const Key beacon = graph.values().size();
  if (count == 1) {
    graph.add_prior(graph.add_value(SE2d(SO2d(), {10, 10})), SE2d(), NoiseModel<3>::from_sigmas({1e3, 1e3, 1}));
    for (const auto& [id, metres] : generated::beacon_distances()) graph.add(DistanceFactor{keys[id], beacon, metres});
  }
  const OptimizeReport report = optimize(graph);
  std::printf("factors    %d, of them %zu distances\ncost       %.6g -> %.6g in %d iterations\n", graph.factor_count(),
              graph.factors<DistanceFactor>().size(), report.initial_cost, report.final_cost, report.iterations);
  if (const auto covariances = marginals(graph); covariances && count == 1)
    for (const int i : {0, 1})
      std::printf("beacon     %.3f +- %.3f m\n", graph[beacon].translation()[i], std::sqrt(covariances->back()(i, i)));
  return report.ok() ? 0 : 1;
} catch (const std::exception& failure) {
  return std::fprintf(stderr, "%s\n", failure.what()), 2;
}
