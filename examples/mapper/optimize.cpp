#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <map>
#include <queue>
#include <string>
#include <vector>

#include "chainslam/core/error.hpp"
#include "chainslam/factor_graph/batch_optimizer.hpp"
#include "chainslam/factor_graph/factor_graph.hpp"
#include "chainslam/io/g2o.hpp"
#include "end_on_interrupt.hpp"
#include "exit_code.hpp"
#include "output.hpp"
#include "verbs.hpp"

namespace chainslam::mapper {

namespace {

/// Gives vertices that the file does not state the place that an edge from a known vertex puts them at: always the
/// first such edge in the file.
template <class Pose>
void add_missing_vertices(G2oRecords<Pose>& records) {
  std::map<std::int64_t, Pose> known;
  std::map<std::int64_t, std::vector<std::size_t>> edges_of;
  std::priority_queue<std::size_t, std::vector<std::size_t>, std::greater<>> next;
  for (std::size_t i = 0; i < records.edges.size(); ++i)
    for (const std::int64_t id : {records.edges[i].from, records.edges[i].to}) edges_of[id].push_back(i);
  const auto add = [&](std::int64_t id, const Pose& pose) {
    if (!known.emplace(id, pose).second) return;
    for (const std::size_t edge : edges_of[id]) next.push(edge);
  };
  for (const auto& vertex : records.vertices) add(vertex.id, vertex.pose);
  const std::size_t stated = known.size();
  if (known.empty() && !records.edges.empty()) add(records.edges.front().from, Pose());
  while (!next.empty()) {
    const auto& edge = records.edges[next.top()];
    next.pop();
    if (const auto from = known.find(edge.from); from != known.end())
      add(edge.to, from->second * edge.measurement);
    else
      add(edge.from, known.at(edge.to) * edge.measurement.inverse());
  }
  if (known.size() == stated) return;
  records.vertices.clear();
  for (const auto& [id, pose] : known) records.vertices.push_back({id, pose});
}

const char* words(OptimizeStatus status) {
  switch (status) {
    case OptimizeStatus::converged:
      return "converged";
    case OptimizeStatus::iteration_limit:
      return "stopped at the iteration limit; raise --max-iterations";
    case OptimizeStatus::stalled:
      return "stalled: no step lowers the cost any more";
    case OptimizeStatus::unconstrained:
      return "parts of the graph are not connected with the first vertex";
    case OptimizeStatus::singular:
      return "a vertex is not fully determined by its edges";
    case OptimizeStatus::diverged:
      return "the cost rose";
    case OptimizeStatus::not_finite:
      return "the cost is not a number";
  }
  return "";
}

template <class Pose>
int optimize_records(G2oFile& file, G2oRecords<Pose>& records, const OptimizeArguments& arguments) {
  add_missing_vertices(records);
  FactorGraph<Pose> graph;
  std::map<std::int64_t, Key> keys;
  for (const auto& vertex : records.vertices) keys.emplace(vertex.id, graph.add_value(vertex.pose));
  const auto key_of = [&](std::int64_t id) {
    const auto found = keys.find(id);
    if (found == keys.end())
      throw_input_error(arguments.input.string(), "vertex " + std::to_string(id),
                        "no pose and no edge to a known vertex", "add a VERTEX line, or the edge that is missing");
    return found->second;
  };
  for (const auto& edge : records.edges) {
    const Key from = key_of(edge.from);  // named first where neither is there
    graph.add_between(from, key_of(edge.to), edge.measurement,
                      NoiseModel<Pose::dof>::from_information(edge.information));
  }
  if (file.fixed.empty()) file.fixed.push_back(records.vertices.front().id);
  for (const std::int64_t id : file.fixed) graph.set_fixed(key_of(id));

  const OptimizeReport report =
      optimize(graph, LevenbergMarquardt{.max_iterations = to_index(arguments.max_iterations)});
  std::printf("poses        %zu\nedges        %zu\ncost (chi2)  %.10g -> %.10g\niterations   %d, %s\n",
              records.vertices.size(), records.edges.size(), report.initial_cost, report.final_cost, report.iterations,
              words(report.status));
  for (const auto& [kind, count] : file.unknown)
    std::printf("skipped      %d lines %s\n", count, printable(kind).c_str());
  if (!report.ok()) {
    for (const Key key : report.variables)
      std::fprintf(stderr, "vertex %lld\n", static_cast<long long>(records.vertices[static_cast<std::size_t>(key)].id));
    throw_input_error(arguments.input.string(), "", words(report.status),
                      "check the edges of the vertices named above");
  }
  if (!arguments.out.empty()) {
    for (std::size_t i = 0; i < records.vertices.size(); ++i) records.vertices[i].pose = graph[static_cast<Key>(i)];
    Output output(arguments.overwrite);
    if (!output.file(arguments.out, [&](const FileTarget& target) { write_g2o(target, file); }))
      return output.exit_code(exit_good);
    std::printf("written      %s\n", printable(arguments.out.native()).c_str());
  }
  return report.status == OptimizeStatus::converged ? exit_good : exit_goal_missed;
}

}  // namespace

int run(const OptimizeArguments& arguments) {
  require_free(arguments.out, arguments.overwrite);
  const EndOnInterrupt interrupt(arguments.out);
  G2oFile file = read_g2o(arguments.input);
  if (file.planar.edges.empty() == file.spatial.edges.empty())
    throw_input_error(arguments.input.string(), "",
                      file.planar.edges.empty() ? "no edges" : "edges in the plane and in space in one file",
                      "give a file with EDGE_SE2 or with EDGE_SE3:QUAT lines");
  return file.spatial.edges.empty() ? optimize_records(file, file.planar, arguments)
                                    : optimize_records(file, file.spatial, arguments);
}

}  // namespace chainslam::mapper
