// Optimizes a pose graph of a g2o file, in the plane or in space, and says how near its optimum is to the global one.
#include <chainslam/factor_graph/batch_optimizer.hpp>
#include <chainslam/factor_graph/certificate.hpp>
#include <chainslam/factor_graph/chordal_initialization.hpp>
#include <chainslam/io/g2o.hpp>
#include <chrono>
#include <cstdio>
#include <exception>
#include <map>
#include <string>

using namespace chainslam;

template <class Pose>
int optimize_records(G2oRecords<Pose>& records, const char* name) {
  std::map<std::int64_t, Pose> poses;
  for (const auto& vertex : records.vertices) poses[vertex.id] = vertex.pose;
  for (const auto& edge : records.edges) poses.try_emplace(edge.from), poses.try_emplace(edge.to);
  FactorGraph<Pose> graph;
  std::map<std::int64_t, Key> keys;
  for (const auto& [id, pose] : poses) keys[id] = graph.add_value(pose);
  for (const auto& edge : records.edges)
    graph.add_between(keys[edge.from], keys[edge.to], edge.measurement,
                      NoiseModel<Pose::dof>::from_information(edge.information));
  graph.set_fixed(0);

  const double initial_cost = graph.cost();
  const auto begin = std::chrono::steady_clock::now();
  if (const auto start = chordal_initialization(graph)) graph.set_values(*start);
  const OptimizeReport report = optimize(graph);
  const std::chrono::duration<double> time = std::chrono::steady_clock::now() - begin;
  if (!report.ok()) {
    const std::string why = report.free.empty() ? "numbers that are too large" : describe(report.free.front());
    throw_input_error(name, "", why, "variables are the vertices by their ids: look at the edges there");
  }
  std::printf("%d poses, %d edges: cost (chi2) %.9g -> %.9g in %.3f s\n", graph.values().size(), graph.factor_count(),
              initial_cost, report.final_cost, time.count());
  if (const auto known = certify(graph)) std::printf("certificate: no poses cost less than %.9g\n", known->lower_bound);
  records.vertices.clear();
  for (const auto& [id, key] : keys) records.vertices.push_back({id, graph[key]});
  return report.status == OptimizeStatus::converged ? 0 : 1;
}

int main(int count, char** arguments) try {
  if (count < 2) return std::fprintf(stderr, "example_optimize_g2o INPUT.g2o [OUTPUT.g2o]\n"), 2;
  G2oFile file = read_g2o(arguments[1]);
  if (file.planar.edges.empty() == file.spatial.edges.empty())
    throw_input_error(arguments[1], "", "no edges, or edges in the plane and in space", "give a file with one kind");
  const int status = file.spatial.edges.empty() ? optimize_records(file.planar, arguments[1])
                                                : optimize_records(file.spatial, arguments[1]);
  if (count > 2) write_g2o(arguments[2], file);
  return status;
} catch (const std::exception& failure) {
  return std::fprintf(stderr, "%s\n", failure.what()), 1;
}
