// Optimises a pose graph of a g2o file and says how near its optimum is to the global one.
#include <chainslam/factor_graph/batch_optimizer.hpp>
#include <chainslam/factor_graph/certificate.hpp>
#include <chainslam/factor_graph/chordal_initialization.hpp>
#include <chainslam/io/g2o.hpp>
#include <chrono>
#include <cstdio>
#include <exception>

int main(int count, char** arguments) try {
  using namespace chainslam;
  if (count < 2) return std::fprintf(stderr, "example_optimize_g2o input.g2o [output.g2o]\n"), 2;
  G2oFile file = read_g2o(arguments[1]);
  auto& records = file.spatial;
  PoseGraph graph;
  for (const auto& vertex : records.vertices) {
    if (vertex.id != graph.add_value(vertex.pose)) return std::fprintf(stderr, "number the vertices 0, 1, ...\n"), 1;
  }
  for (const auto& edge : records.edges)
    graph.add_between(static_cast<Key>(edge.from), static_cast<Key>(edge.to), edge.measurement,
                      NoiseModel<6>::from_information(edge.information));
  if (graph.values().size() > 0) graph.set_fixed(0);

  const auto begin = std::chrono::steady_clock::now();
  if (const auto start = chordal_initialization(graph)) graph.set_values(*start);
  const OptimizeReport report = optimise(graph);
  const std::chrono::duration<double> time = std::chrono::steady_clock::now() - begin;
  std::printf("%d poses, %d edges: chi2 %.10g -> %.10g in %.3f s\n", graph.values().size(), graph.factor_count(),
              report.initial_cost, report.final_cost, time.count());
  if (const auto certificate = certify(graph)) std::printf("no poses cost less than %.10g\n", certificate->lower_bound);
  for (auto& vertex : records.vertices) vertex.pose = graph[static_cast<Key>(vertex.id)];
  if (count > 2) write_g2o(arguments[2], file);
  return report.ok() ? 0 : 1;
} catch (const std::exception& failure) {
  return std::fprintf(stderr, "%s\n", failure.what()), 1;
}
