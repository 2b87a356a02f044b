#include <benchmark/benchmark.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <map>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

#include "chainslam/factor_graph/incremental_smoother.hpp"
#include "chainslam/lie/se2.hpp"
#include "pose_graphs.hpp"
#include "versus.hpp"

namespace chainslam {
namespace {

/// GTSAM's iSAM2 on the same feed, as published for another machine (4.3a0, default flags, thresholds 0.1): not run
/// here, so the ratios to it tell orders of magnitude only. 0: not published.
struct Published {
  double total_s, p99_ms, max_ms;
};

struct Case {
  const char* name;
  Published gtsam;
};
constexpr Case cases[] = {{"ms5x2000", {33.1, 38.9, 183.0}},     {"ms5x2000_late", {24.8, 29.5, 159.0}},
                          {"parking-garage", {4.4, 32.5, 34.1}}, {"manhattan", {4.7, 21.0, 42.8}},
                          {"city10000", {91.0, 41.1, 168.0}},    {"sphere2500", {34.9, 32.3, 46.4}},
                          {"torus3D", {195.3, 170.9, 324.7}}};

/// What comes with one pose: its first guess, if no edge leads back from it, and its edges to earlier poses.
template <class Pose>
struct Step {
  struct Edge {
    Key from, to;
    Pose measurement;
    NoiseModel<Pose::dof> noise;
  };
  std::optional<Pose> guess;
  std::vector<Edge> edges;
};

template <class Pose>
std::vector<Step<Pose>> steps_of(const G2oRecords<Pose>& records) {
  std::map<std::int64_t, Pose> vertices;
  for (const auto& vertex : records.vertices) vertices[vertex.id] = vertex.pose;
  std::vector<Step<Pose>> steps;
  for (const auto& edge : records.edges) {
    const auto newest = static_cast<std::size_t>(std::max(edge.from, edge.to));
    if (steps.size() <= newest) steps.resize(newest + 1);
    steps[newest].edges.push_back({static_cast<Key>(edge.from), static_cast<Key>(edge.to), edge.measurement,
                                   NoiseModel<Pose::dof>::from_information(edge.information)});
  }
  for (std::size_t k = 0; k < steps.size(); ++k) {
    const auto vertex = vertices.find(static_cast<std::int64_t>(k));
    if (steps[k].edges.empty()) steps[k].guess = vertex == vertices.end() ? Pose() : vertex->second;
  }
  return steps;
}

/// Adds a pose where the edge to its newest earlier neighbour puts it; a weak prior (50 m, 0.5 rad) where there is
/// none.
template <class Pose>
void add(IncrementalSmoother<Pose>& smoother, const Step<Pose>& step) {
  using Noise = NoiseModel<Pose::dof>;
  const Key key = smoother.size();
  Pose guess = step.guess.value_or(Pose());
  Key newest = -1;
  for (const auto& edge : step.edges) {
    const Key other = edge.from == key ? edge.to : edge.from;
    if (other <= newest) continue;
    newest = other;
    guess = edge.from == key ? smoother[other] * edge.measurement.inverse() : smoother[other] * edge.measurement;
  }
  smoother.add_value(guess);
  if (step.guess) {
    typename Noise::Vector sigmas = Noise::Vector::Constant(key == 0 ? 1e-4 : 50.0);
    if (key > 0) sigmas.template tail<Pose::dof == 6 ? 3 : 1>().setConstant(0.5);
    smoother.add_prior(key, guess, Noise::from_sigmas(sigmas));
  }
  for (const auto& edge : step.edges) smoother.add_between(edge.from, edge.to, edge.measurement, edge.noise);
}

double resident_megabytes() {
  long pages = 0, resident = 0;
  if (std::FILE* const file = std::fopen("/proc/self/statm", "r")) {
    if (std::fscanf(file, "%ld %ld", &pages, &resident) != 2) resident = 0;
    std::fclose(file);
  }
  return static_cast<double>(resident) * static_cast<double>(sysconf(_SC_PAGESIZE)) / 1e6;
}

/// One pose at a time: insert, update, read the pose before.
template <class Pose>
void feed(benchmark::State& state, const std::vector<Step<Pose>>& steps, const Published& gtsam) {
  for (auto _ : state) {
    const double before = resident_megabytes();
    std::vector<double> latencies;
    latencies.reserve(steps.size());
    double total = 0.0, multiplications = 0.0;
    IncrementalSmoother<Pose> smoother;
    for (const Step<Pose>& step : steps) {
      const double start = bench::ThreadTime::now();
      add(smoother, step);
      const UpdateReport report = smoother.update();
      if (!report.ok()) throw std::runtime_error("an update failed");
      benchmark::DoNotOptimize(smoother[std::max(0, smoother.size() - 2)]);
      latencies.push_back(bench::ThreadTime::now() - start);
      total += latencies.back();
      multiplications += report.work.multiplications;
    }
    state.SetIterationTime(total);
    state.counters["rss_mb"] = resident_megabytes() - before;
    std::sort(latencies.begin(), latencies.end());
    const double p99 = 1e3 * latencies[latencies.size() * 99 / 100], most = 1e3 * latencies.back();
    const double cost = smoother.cost();
    if (!smoother.converge().ok()) throw std::runtime_error("converge failed");
    state.counters["total_s"] = total;
    state.counters["p50_ms"] = 1e3 * latencies[latencies.size() / 2];
    state.counters["p99_ms"] = p99;
    state.counters["max_ms"] = most;
    state.counters["gflop"] = 2e-9 * multiplications;
    state.counters["cost_over_optimum"] = cost / smoother.cost();
    state.counters["chi2"] = smoother.cost();
    state.counters["total_vs_published_gtsam"] = gtsam.total_s / total;
    state.counters["p99_vs_published_gtsam"] = gtsam.p99_ms / p99;
    state.counters["max_vs_published_gtsam"] = gtsam.max_ms / most;
  }
}

template <class Pose>
void add_bench(const Case& graph, const G2oRecords<Pose>& records) {
  const auto steps = std::make_shared<const std::vector<Step<Pose>>>(steps_of(records));
  benchmark::RegisterBenchmark((std::string("factor_graph/incremental/") + graph.name).c_str(),
                               [steps, graph](benchmark::State& state) { feed(state, *steps, graph.gtsam); })
      ->UseManualTime()
      ->Iterations(1)
      ->Unit(benchmark::kSecond);
}

const bool registered = [] {
  for (const Case& graph : cases) {
    const auto file = bench::real_pose_graph(graph.name);
    if (!file) continue;
    if (!file->spatial.edges.empty()) {
      add_bench(graph, file->spatial);
    } else {
      add_bench(graph, file->planar);
    }
  }
  return true;
}();

}  // namespace
}  // namespace chainslam
