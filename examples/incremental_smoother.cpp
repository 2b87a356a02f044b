// Incremental smoothing: poses are added one by one; a loop closure corrects them all; covariances say how far to
// trust. Usage: example_incremental_smoother [GRAPH.g2o] of SE(3) edges in the order in which they were measured.
#include <chainslam/factor_graph/incremental_smoother.hpp>
#include <chainslam/io/g2o.hpp>
#include <cstdio>

#include "generated/circle_edges.hpp"

using namespace chainslam;

int main(int count, char** arguments) try {
  const auto edges = count == 2 ? read_g2o(arguments[1]).spatial.edges : generated::circle_edges();
  IncrementalSmoother<SE3d> smoother;
  std::map<std::int64_t, Key> keys;
  const auto sigma = [&](Key key) { return std::sqrt(smoother.covariance(key).topLeftCorner(3, 3).trace()); };
  for (const G2oEdge<SE3d>& edge : edges) {
    if (keys.empty()) {  // something must hold the graph: a prior on its first pose
      keys[edge.from] = smoother.add_value(SE3d());
      smoother.add_prior(keys[edge.from], SE3d(), NoiseModel<6>::from_sigma(1e-3));
    }
    const Key from = keys.at(edge.from);
    const bool closes_loop = keys.contains(edge.to);
    if (!closes_loop) keys[edge.to] = smoother.add_value(smoother[from] * edge.measurement);
    const Key to = keys.at(edge.to);
    const double before = closes_loop ? sigma(to) : 0;
    smoother.add_between(from, to, edge.measurement, NoiseModel<6>::from_information(edge.information));
    const UpdateReport report = smoother.update();
    if (!report.ok()) throw std::runtime_error("the update failed");
    if (closes_loop && smoother.count<BetweenFactor<SE3d>>() % 50 == 0)
      std::printf("loop       %d - %d: sigma of its end %.3f -> %.3f m, %d factors relinearized\n", from, to, before,
                  sigma(to), report.relinearized);
  }
  const ConvergeReport report = smoother.converge();
  const Key last = smoother.size() - 1, middle = last / 2;
  std::printf("poses      %d, factors %d\ncost       %.4f -> %.4f\n", smoother.size(), smoother.factor_count(),
              report.initial_cost, report.final_cost);
  std::printf("sigma      %.3f m in the middle, %.3f m at the end, %.3f m of the end from the middle\n", sigma(middle),
              sigma(last), std::sqrt(smoother.relative_covariance(middle, last).topLeftCorner<3, 3>().trace()));
  return report.ok() ? 0 : 1;
} catch (const std::exception& failure) {
  return std::fprintf(stderr, "%s\n", failure.what()), 2;
}
