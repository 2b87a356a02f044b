#include <benchmark/benchmark.h>
#include <malloc.h>
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

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/factor_graph/incremental_smoother.hpp"
#include "chainslam/lie/se2.hpp"
#include "pose_graphs.hpp"
#include "versus.hpp"
#ifdef CHAINSLAM_PEER_GTSAM
#include "factor_graph/peers/isam2.hpp"
#endif

namespace chainslam {
namespace {

constexpr const char* graphs[] = {"ms5x2000",  "ms5x2000_late", "parking-garage", "manhattan",
                                  "city10000", "sphere2500",    "torus3D",        "cubicle"};
constexpr const char* anxious_graphs[] = {"ms5x2000", "ms5x2000_late"};

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

/// Adds to ours or to a peer a pose where the edge to its newest earlier neighbour puts it; a weak prior (50 m, 0.5
/// rad) where there is none.
template <class Smoother, class Pose>
void add(Smoother& smoother, const Step<Pose>& step) {
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
  anxious  ///< as FAST_LIO_SAM: tighter, an update more a pose, five more with a closure, and all poses read
};

template <class Pose>
SmootherOptions options_of(Habit habit) {
  if (habit == Habit::plain) return {};
  return {.linear_tolerance = 3e-6, .nonlinear_tolerance = 3e-6};
}

/// What one feed took, in the thread's time.
struct Latencies {
  std::vector<double> steps{};  ///< seconds, the shortest first
  double total = 0.0;           ///< seconds
  double megabytes = 0.0;       ///< that the process grew by, what others left to the heap not counted

  [[nodiscard]] double p50_ms() const { return 1e3 * steps[steps.size() / 2]; }
  [[nodiscard]] double p99_ms() const { return 1e3 * steps[steps.size() * 99 / 100]; }
  [[nodiscard]] double max_ms() const { return 1e3 * steps.back(); }
};

/// `take(k)` takes pose k and its edges.
template <class Take>
Latencies timed(std::size_t count, Take&& take) {
  Latencies result;
  result.steps.reserve(count);
  malloc_trim(0);  // else the feed would live in what reading the graphs has left
  const double before = resident_megabytes();
  for (std::size_t k = 0; k < count; ++k) {
    const double start = bench::ThreadTime::now();
    take(k);
    result.steps.push_back(bench::ThreadTime::now() - start);
    result.total += result.steps.back();
  }
  result.megabytes = resident_megabytes() - before;
  std::sort(result.steps.begin(), result.steps.end());
  return result;
}

int updates_after(Habit habit, std::size_t edges) { return habit == Habit::plain ? 0 : edges > 1 ? 6 : 1; }

#ifdef CHAINSLAM_PEER_GTSAM
template <class Pose>
void feed_gtsam(benchmark::State& state, const std::vector<Step<Pose>>& steps, Habit habit, const Latencies& ours) {
  bench::Isam2<Pose> isam(habit == Habit::plain ? 0.1 : 0.01);
  const Latencies theirs = timed(steps.size(), [&](std::size_t k) {
    add(isam, steps[k]);
    for (int update = updates_after(habit, steps[k].edges.size()); update >= 0; --update) isam.update();
    if (habit == Habit::anxious) benchmark::DoNotOptimize(isam.read_all());
    if (habit == Habit::plain) benchmark::DoNotOptimize(isam[std::max(0, isam.size() - 2)]);
  });
  state.counters["gtsam_s"] = theirs.total;
  state.counters["gtsam_chi2"] = isam.cost();
  state.counters["gtsam_rss_mb"] = theirs.megabytes;
  state.counters["speedup_vs_gtsam"] = theirs.total / ours.total;
  state.counters["p99_speedup_vs_gtsam"] = theirs.p99_ms() / ours.p99_ms();
  state.counters["max_speedup_vs_gtsam"] = theirs.max_ms() / ours.max_ms();
}
#else
template <class Pose>
void feed_gtsam(benchmark::State&, const std::vector<Step<Pose>>&, Habit, const Latencies&) {}
#endif

/// One pose at a time.
template <class Pose>
void feed(benchmark::State& state, const std::vector<Step<Pose>>& steps, Habit habit) {
  for (auto _ : state) {
    double multiplications = 0.0;
    Index refused = 0;
    IncrementalSmoother<Pose> smoother(options_of<Pose>(habit));
    const Latencies latencies = timed(steps.size(), [&](std::size_t k) {
      // What an update has refused, since its numbers say too little, comes again with the next.
      for (auto next = static_cast<std::size_t>(smoother.size()); next <= k; ++next) add(smoother, steps[next]);
      const UpdateReport report = smoother.update();
      if (!report.ok()) ++refused;
      multiplications += report.work.multiplications;
      for (int update = updates_after(habit, steps[k].edges.size()); update > 0; --update) {
        if (!smoother.update().ok()) throw std::runtime_error("an update failed");
      }
      if (habit == Habit::anxious) benchmark::DoNotOptimize(smoother.values());
      if (habit == Habit::plain) benchmark::DoNotOptimize(smoother[std::max(0, smoother.size() - 2)]);
    });
    if (smoother.size() < to_index(steps.size())) throw std::runtime_error("the last update failed");
    state.SetIterationTime(latencies.total);
    const double cost = smoother.cost();
    const double before_converge = bench::ThreadTime::now();
    const ConvergeReport end = smoother.converge();
    if (!end.ok()) throw std::runtime_error("converge failed");
    state.counters["refused"] = refused;
    state.counters["rss_mb"] = latencies.megabytes;
    state.counters["converge_s"] = bench::ThreadTime::now() - before_converge;
    state.counters["converge_method"] = static_cast<double>(end.method);
    state.counters["total_s"] = latencies.total;
    state.counters["p50_ms"] = latencies.p50_ms();
    state.counters["p99_ms"] = latencies.p99_ms();
    state.counters["max_ms"] = latencies.max_ms();
    state.counters["gflop"] = 2e-9 * multiplications;
    state.counters["cost_over_optimum"] = cost / smoother.cost();
    state.counters["chi2"] = smoother.cost();
    feed_gtsam(state, steps, habit, latencies);
  }
}

/// What some steps of a growing graph took, in the thread's time.
struct Share {
  double seconds = 0.0, longest = 0.0;
  Index steps = 0;
  Offset closures = 0;

  void add(double taken, std::size_t closed) {
    seconds += taken;
    longest = std::max(longest, taken);
    ++steps;
    closures += static_cast<Offset>(closed);
  }
  [[nodiscard]] double mean_us() const { return 1e6 * seconds / steps; }
  [[nodiscard]] double closures_per_step() const { return static_cast<double>(closures) / steps; }
  [[nodiscard]] double us_per_closure() const { return mean_us() / closures_per_step(); }
};

/// Feeds a generated walk and times its last 5000 steps, in which it has its full size; and compares its last tenth
/// with all, by step and by closure, since the town fills up and later steps come with more closures.
void growth(benchmark::State& state) {
  const auto poses = static_cast<Index>(state.range(0));
  for (auto _ : state) {
    malloc_trim(0);
    const double before = resident_megabytes();
    test::StreetWalk walk(test::StreetWalkOptions::of_size(poses, 1));
    IncrementalSmoother<SE3d> smoother;
    Share all, tenth, last;
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
      const double seconds = bench::ThreadTime::now() - start;
      all.add(seconds, step.closures.size());
      if (key >= poses - poses / 10) tenth.add(seconds, step.closures.size());
      if (key >= poses - 5000) last.add(seconds, step.closures.size());
    }
    state.SetIterationTime(last.seconds);
    state.counters["mean_us"] = last.mean_us();
    state.counters["max_ms"] = 1e3 * last.longest;
    state.counters["all_s"] = all.seconds;
    state.counters["tenth_over_mean"] = tenth.mean_us() / all.mean_us();
    state.counters["closures_tenth_over_mean"] = tenth.closures_per_step() / all.closures_per_step();
    state.counters["per_closure_tenth_over_mean"] = tenth.us_per_closure() / all.us_per_closure();
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

/// A step of `converge` at the optimum: all is linearized and factorized anew. Of the wall, two threads and one.
template <class Pose>
void full_step(benchmark::State& state, const FactorGraph<Pose>& graph) {
  const ThreadPool pool(2);
  IncrementalSmoother<Pose> one, two;
  one.append(graph);
  two.append(graph);
  if (!one.converge().ok() || !two.converge({}, pool).ok()) throw std::runtime_error("converge failed");
  if (one.values() != two.values()) throw std::runtime_error("two threads give other bits");
  bench::versus<bench::WallTime>(
      state, [&] { return two.converge({}, pool).iterations; },
      bench::Peer{"one_thread", [&] { return one.converge().iterations; }});
}

template <class Pose>
void add_full_step(const std::string& graph_name, const G2oRecords<Pose>& records) {
  const auto graph = std::make_shared<const FactorGraph<Pose>>(bench::graph_of(records));
  benchmark::RegisterBenchmark(("factor_graph/two_threads/" + graph_name).c_str(),
                               [graph](benchmark::State& state) { full_step(state, *graph); })
      ->UseManualTime()
      ->Unit(benchmark::kMillisecond);
}

template <class Pose>
void add_bench(const std::string& graph, const G2oRecords<Pose>& records, Habit habit) {
  const auto steps = std::make_shared<const std::vector<Step<Pose>>>(steps_of(records));
  const char* const name = habit == Habit::plain ? "factor_graph/incremental/" : "factor_graph/incremental_anxious/";
  benchmark::RegisterBenchmark((name + graph).c_str(),
                               [steps, habit](benchmark::State& state) { feed(state, *steps, habit); })
      ->UseManualTime()
      ->Iterations(1)
      ->Unit(benchmark::kSecond);
}

const bool registered = [] {
  const auto add = [](const char* graph, Habit habit) {
    const auto file = bench::real_pose_graph(graph);
    if (!file) return;
    if (!file->spatial.edges.empty()) {
      add_bench(graph, file->spatial, habit);
    } else {
      add_bench(graph, file->planar, habit);
    }
  };
  for (const char* graph : graphs) add(graph, Habit::plain);
  for (const char* graph : anxious_graphs) add(graph, Habit::anxious);
  for (const char* graph : {"ms5x2000", "sphere2500", "torus3D"}) {
    if (const auto file = bench::real_pose_graph(graph)) add_full_step(graph, file->spatial);
  }
  return true;
}();

}  // namespace
}  // namespace chainslam
