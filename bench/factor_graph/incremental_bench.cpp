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
                          {"torus3D", {195.3, 170.9, 324.7}},    {"cubicle", {126.4, 113.2, 343.3}}};
/// iSAM2 as FAST_LIO_SAM uses it: threshold 0.01, one more update a keyframe, five more with a closure, all estimates
/// read at each keyframe.
constexpr Case habit_cases[] = {{"ms5x2000", {229.7, 225.5, 822.0}}, {"ms5x2000_late", {195.0, 161.0, 358.0}}};

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
                                   test::edge_noise<Pose>(edge.information)});
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

enum class Habit {
  plain,   ///< insert, update, read the pose before
  anxious  ///< tighter, with more updates than are needed, and all poses read
};

template <class Pose>
SmootherOptions options_of(Habit habit) {
  if (habit == Habit::plain) return {};
  return {.linear_tolerance = 3e-6, .nonlinear_tolerance = 3e-6};
}

template <class Pose>
void follow(IncrementalSmoother<Pose>& smoother, const Step<Pose>& step, Habit habit) {
  if (habit == Habit::plain) {
    benchmark::DoNotOptimize(smoother[std::max(0, smoother.size() - 2)]);
    return;
  }
  const int more = step.edges.size() > 1 ? 6 : 1;
  for (int k = 0; k < more; ++k) {
    if (!smoother.update().ok()) throw std::runtime_error("an update failed");
  }
  benchmark::DoNotOptimize(smoother.values());
}

/// One pose at a time.
template <class Pose>
void feed(benchmark::State& state, const std::vector<Step<Pose>>& steps, const Published& gtsam, Habit habit) {
  for (auto _ : state) {
    const double before = resident_megabytes();
    std::vector<double> latencies;
    latencies.reserve(steps.size());
    double total = 0.0, multiplications = 0.0;
    IncrementalSmoother<Pose> smoother(options_of<Pose>(habit));
    Index refused = 0;
    for (std::size_t k = 0; k < steps.size(); ++k) {
      const Step<Pose>& step = steps[k];
      const double start = bench::ThreadTime::now();
      // What an update has refused, since its numbers say too little, comes again with the next.
      for (auto next = static_cast<std::size_t>(smoother.size()); next <= k; ++next) add(smoother, steps[next]);
      const UpdateReport report = smoother.update();
      if (!report.ok()) ++refused;
      follow(smoother, step, habit);
      latencies.push_back(bench::ThreadTime::now() - start);
      total += latencies.back();
      multiplications += report.work.multiplications;
    }
    if (smoother.size() < to_index(steps.size())) throw std::runtime_error("the last update failed");
    state.SetIterationTime(total);
    state.counters["refused"] = refused;
    state.counters["rss_mb"] = resident_megabytes() - before;
    std::sort(latencies.begin(), latencies.end());
    const double p99 = 1e3 * latencies[latencies.size() * 99 / 100], most = 1e3 * latencies.back();
    const double cost = smoother.cost();
    const double before_converge = bench::ThreadTime::now();
    const ConvergeReport end = smoother.converge();
    if (!end.ok()) throw std::runtime_error("converge failed");
    state.counters["converge_s"] = bench::ThreadTime::now() - before_converge;
    state.counters["converge_method"] = static_cast<double>(end.method);
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

/// Feeds a generated walk and times its last 5000 steps, in which it has its full size.
void growth(benchmark::State& state) {
  const auto poses = static_cast<Index>(state.range(0));
  for (auto _ : state) {
    const double before = resident_megabytes();
    test::StreetWalk walk(test::StreetWalkOptions::of_size(poses, 1));
    IncrementalSmoother<SE3d> smoother;
    double total = 0.0, longest = 0.0;
    Index timed = 0;
    while (!walk.done()) {
      const test::StreetWalk::Step step = walk.next();
      const double start = bench::ThreadTime::now();
      const Key key = smoother.size();
      smoother.add_value(step.starts ? step.motion : smoother[key - 1] * step.motion);
      if (step.starts) smoother.add_prior(key, step.motion, test::StreetWalk::start_noise());
      if (!step.starts) smoother.add_between(key - 1, key, step.motion, test::StreetWalk::odometry_noise());
      for (const auto& closure : step.closures)
        smoother.add_between(closure.from, key, closure.T_from_to, test::StreetWalk::closure_noise());
      if (!smoother.update().ok()) throw std::runtime_error("an update failed");
      if (key < poses - 5000) continue;
      const double seconds = bench::ThreadTime::now() - start;
      total += seconds;
      longest = std::max(longest, seconds);
      ++timed;
    }
    state.SetIterationTime(total);
    state.counters["mean_us"] = 1e6 * total / timed;
    state.counters["max_ms"] = 1e3 * longest;
    state.counters["factors"] = static_cast<double>(smoother.factor_count());
    state.counters["rss_mb"] = resident_megabytes() - before;
  }
}
BENCHMARK(growth)
    ->Name("factor_graph/growth")
    ->ArgName("poses")
    ->RangeMultiplier(10)
    ->Range(10'000, 1'000'000)
    ->UseManualTime()
    ->Iterations(1)
    ->Unit(benchmark::kSecond);

template <class Pose>
void add_bench(const Case& graph, const G2oRecords<Pose>& records, Habit habit) {
  const auto steps = std::make_shared<const std::vector<Step<Pose>>>(steps_of(records));
  const char* const name = habit == Habit::plain ? "factor_graph/incremental/" : "factor_graph/incremental_anxious/";
  benchmark::RegisterBenchmark(
      (std::string(name) + graph.name).c_str(),
      [steps, graph, habit](benchmark::State& state) { feed(state, *steps, graph.gtsam, habit); })
      ->UseManualTime()
      ->Iterations(1)
      ->Unit(benchmark::kSecond);
}

const bool registered = [] {
  const auto add = [](const Case& graph, Habit habit) {
    const auto file = bench::real_pose_graph(graph.name);
    if (!file) return;
    if (!file->spatial.edges.empty()) {
      add_bench(graph, file->spatial, habit);
    } else {
      add_bench(graph, file->planar, habit);
    }
  };
  for (const Case& graph : cases) add(graph, Habit::plain);
  for (const Case& graph : habit_cases) add(graph, Habit::anxious);
  return true;
}();

}  // namespace
}  // namespace chainslam
