#include "chainslam/factor_graph/marginals.hpp"

#include <benchmark/benchmark.h>

#include <memory>
#include <span>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "chainslam/factor_graph/batch_optimizer.hpp"
#include "chainslam/factor_graph/chordal_initialization.hpp"
#include "chainslam/factor_graph/factors.hpp"
#include "chainslam/factor_graph/incremental_smoother.hpp"
#include "pose_graphs.hpp"
#include "versus.hpp"

namespace chainslam {
namespace {

template <class Group>
IncrementalSmoother<Group> smoother_of(const FactorGraph<Group>& graph) {
  IncrementalSmoother<Group> smoother;
  for (Key key = 0; key < graph.values().size(); ++key) {
    smoother.add_value(graph[key]);
    smoother.set_fixed(key, graph.is_fixed(key));
  }
  graph.for_each_factor([&](const auto& factor) { smoother.add(factor); });
  if (!smoother.update().ok()) throw std::runtime_error("the update failed");
  return smoother;
}

/// The covariance of every pose, by the sparse inverse; beside it the same one by one, a hundred of them timed.
template <class Group>
void all_marginals(benchmark::State& state, const FactorGraph<Group>& graph) {
  const IncrementalSmoother<Group> smoother = smoother_of(graph);
  for (auto _ : state) {
    const double start = bench::ThreadTime::now();
    benchmark::DoNotOptimize(smoother.marginals());
    state.SetIterationTime(bench::ThreadTime::now() - start);
  }
  const double before_batch = bench::ThreadTime::now();
  if (!marginals(graph)) throw std::runtime_error("the batch marginals failed");
  state.counters["from_nothing_s"] = bench::ThreadTime::now() - before_batch;
  const double start = bench::ThreadTime::now();
  for (Index k = 0; k < 100; ++k) {
    const auto key = static_cast<Key>(std::int64_t{k} * smoother.size() / 100);
    benchmark::DoNotOptimize(smoother.covariance(key));
  }
  state.counters["one_by_one_s"] = (bench::ThreadTime::now() - start) * smoother.size() / 100;
}

/// What five measurements of the last pose change together, as a closure does with what is chained from it; next to
/// each by itself.
template <class Group>
void forecast(benchmark::State& state, const FactorGraph<Group>& graph) {
  const IncrementalSmoother<Group> smoother = smoother_of(graph);
  const Key last = smoother.size() - 1;
  std::vector<BetweenFactor<Group>> factors;
  for (Index k = 1; k <= 5; ++k) {
    const Key from = last / 6 * k;
    factors.push_back({from, last, smoother[from].inverse() * smoother[last], SqrtInformation<Group::dof>::Identity()});
  }
  const auto all = [&] { return smoother.rise_with(std::span(std::as_const(factors))).change; };
  const auto each = [&] {
    double sum = 0;
    for (const auto& one : factors) sum += smoother.rise_with(std::span(&one, 1)).change;
    return sum;
  };
  bench::versus(state, all, bench::Peer{"one_by_one", each});
}

template <class Group>
void chordal(benchmark::State& state, const FactorGraph<Group>& graph) {
  for (auto _ : state) benchmark::DoNotOptimize(chordal_initialization(graph));
}

const bool registered = [] {
  bench::for_each_pose_graph([](const std::string& name, const auto& graph) {
    using Graph = std::remove_cvref_t<decltype(graph)>;
    const auto kept = std::make_shared<const Graph>(graph);
    benchmark::RegisterBenchmark(("factor_graph/marginals/" + name).c_str(),
                                 [kept](benchmark::State& state) { all_marginals(state, *kept); })
        ->UseManualTime()
        ->Unit(benchmark::kMillisecond);
    benchmark::RegisterBenchmark(("factor_graph/forecast/" + name).c_str(),
                                 [kept](benchmark::State& state) { forecast(state, *kept); })
        ->UseManualTime()
        ->Unit(benchmark::kMicrosecond);
    benchmark::RegisterBenchmark(("factor_graph/chordal/" + name).c_str(), [kept](benchmark::State& state) {
      chordal(state, *kept);
    })->Unit(benchmark::kMillisecond);
  });
  return true;
}();

}  // namespace
}  // namespace chainslam
