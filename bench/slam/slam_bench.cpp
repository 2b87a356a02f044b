#include <benchmark/benchmark.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <span>
#include <stdexcept>
#include <utility>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/slam/back_end.hpp"
#include "versus.hpp"

// What the map costs as it grows, without scans: everything here is ours alone, there is no peer to compare with.

namespace chainslam {
namespace {

/// Finds nothing.
struct NoCloser {
  template <Executor E>
  std::vector<LoopClosure> close(std::span<const Keyframe>, const PositionIndex&, const E&) const {
    return {};
  }
};

Keyframe keyframe_at(Index i, const SE3d& T_odom_body) {
  Keyframe keyframe;
  keyframe.time = Timestamp::from_seconds(i);
  keyframe.T_odom_body = T_odom_body;
  return keyframe;
}

/// A way on a circle of 500 m, three metres a keyframe.
SE3d on_circle(Index i) {
  const double angle = 0.006 * i;
  return SE3d(SO3d::exp({0, 0, angle}), {500 * std::sin(angle), 500 * (1 - std::cos(angle)), 0});
}

/// N(j) in a graph of 10^5 keyframes whose closures form components of so many, each keyframe with three at random.
void connected(benchmark::State& state) {
  constexpr Index keyframes = 100'000;
  const auto component = static_cast<Index>(state.range(0));
  ClosureGraph graph(keyframes);
  Rng rng(1);
  for (Index i = 0; i < keyframes; ++i) {
    const Index first = i / component * component;
    for (int closures = 0; closures < 3; ++closures) {
      const auto other = first + rng.uniform_index(component);
      if (other != i && other < keyframes) graph.add_edge(i, other, i);
    }
  }
  ChainedCloser closer;
  Index j = 0;
  std::size_t found = 0;
  for (auto _ : state) {
    found += closer.connected(graph, KeyframeId{j}, keyframes).size();
    j = (j + 7919) % keyframes;
  }
  state.counters["found"] = static_cast<double>(found) / static_cast<double>(state.iterations());
}
BENCHMARK(connected)
    ->Name("slam/chained_closer/connected")
    ->ArgName("component")
    ->RangeMultiplier(10)
    ->Range(10, 10'000);

/// Proposals for one keyframe among 10^5 fixes, ten passes over the same streets.
void gnss_candidates(benchmark::State& state) {
  constexpr Index keyframes = 100'000;
  SlamMap map;
  map.sessions.push_back({SessionId{0}, {}, 0, keyframes, SessionId{0}, {}, {}});
  map.sessions.push_back({SessionId{1}, {}, keyframes, 1, SessionId{1}, {}, {}});
  const auto put = [&](const Eigen::Vector3d& position, SessionId session) {
    Keyframe keyframe;
    keyframe.id = KeyframeId{to_index(map.keyframes.size())};
    keyframe.session = session;
    keyframe.gnss = GnssFix{{}, position, Eigen::Matrix3d::Identity(), GnssQuality::three_dimensional};
    map.keyframes.push_back(keyframe);
  };
  Rng rng(2);
  for (Index i = 0; i < keyframes; ++i) {
    const double angle = 2e-4 * 3.141592653589793 * (i % 10'000);  // a circle of 30 km
    const Eigen::Vector3d ground(0, 4775 * std::cos(angle), 4775 * std::sin(angle));
    put(ground + Eigen::Vector3d(6'371'000, rng.normal(), rng.normal()), SessionId{0});
  }
  put({6'371'000, 4775, 0}, SessionId{1});
  GnssCandidates candidates;
  benchmark::DoNotOptimize(candidates.find(map, KeyframeId{keyframes}));  // puts the fixes into a tree
  for (auto _ : state) benchmark::DoNotOptimize(candidates.find(map, KeyframeId{keyframes}));
}
BENCHMARK(gnss_candidates)->Name("slam/gnss_candidates/find/100000");

/// Carrying a session of as many keyframes over into the frame of another, closing it there, and optimizing.
void join(benchmark::State& state) {
  const auto each = static_cast<Index>(state.range(0)) / 2;
  for (auto _ : state) {
    MapGraph<> graph;
    for (int session = 0; session < 2; ++session) {
      graph.begin_session({});
      for (Index i = 0; i < each; ++i) graph.append(keyframe_at(i, on_circle(i)));
    }
    if (!graph.optimize().ok()) throw std::runtime_error("the first optimization failed");
    LoopClosure closure{.from = {each / 2}, .to = {each + each / 2}, .T_from_to = SE3d(SO3d(), {0.5, 0, 0})};
    closure.sqrt_information = 20.0 * SqrtInformation<6>::Identity();
    const double start = bench::ThreadTime::now();
    graph.join(SessionId{0}, SessionId{1}, SE3d(SO3d::exp({0, 0, 0.3}), {40, -25, 1}));
    graph.accept(closure);
    if (!graph.optimize().ok()) throw std::runtime_error("the optimization failed");
    state.SetIterationTime(bench::ThreadTime::now() - start);
  }
}
BENCHMARK(join)->Name("slam/map_graph/join")->ArgName("keyframes")->Arg(5'000)->UseManualTime();

/// A drive of many rounds of 1047 keyframes, each keyframe in ten closed with the round before: what optimizing costs.
void optimize(benchmark::State& state) {
  const auto keyframes = static_cast<Index>(state.range(0));
  for (auto _ : state) {
    MapGraph<> graph;
    Rng rng(3);
    std::vector<double> seconds;
    SE3d drifted;
    for (Index i = 0; i < keyframes; ++i) {
      if (i > 0) {
        Vector6d noise;
        for (double& value : noise) value = rng.normal();
        noise.head<3>() *= 0.02;
        noise.tail<3>() *= 1e-3;
        drifted = drifted * on_circle(i - 1).inverse() * on_circle(i) * SE3d::exp(noise);
      }
      graph.append(keyframe_at(i, drifted));
      if (i % 10 != 0 || i < 1047) continue;
      LoopClosure closure{.from = {i - 1047}, .to = {i}, .T_from_to = on_circle(i - 1047).inverse() * on_circle(i)};
      closure.sqrt_information = 20.0 * SqrtInformation<6>::Identity();
      graph.accept(closure);
      const double start = bench::ThreadTime::now();
      if (!graph.optimize().ok()) throw std::runtime_error("an optimization failed");
      seconds.push_back(bench::ThreadTime::now() - start);
    }
    std::ranges::sort(seconds);
    double total = 0.0;
    for (const double one : seconds) total += one;
    state.SetIterationTime(total);
    state.counters["mean_ms"] = 1e3 * total / static_cast<double>(seconds.size());
    state.counters["p99_ms"] = 1e3 * seconds[seconds.size() * 99 / 100];
    state.counters["max_ms"] = 1e3 * seconds.back();
  }
}
BENCHMARK(optimize)
    ->Name("slam/map_graph/optimize")
    ->ArgName("keyframes")
    ->Arg(3'000)
    ->Arg(10'000)
    ->UseManualTime()
    ->Iterations(1)
    ->Unit(benchmark::kSecond);

/// What a keyframe costs that closes no loop, in a map of so many: it should not depend on their number.
void add(benchmark::State& state) {
  const auto keyframes = static_cast<Index>(state.range(0));
  for (auto _ : state) {
    BackEnd<NoCloser, NoChaining, NoMerging> back_end;
    for (Index i = 0; i < keyframes; ++i) back_end.add(keyframe_at(i, on_circle(i)));
    benchmark::DoNotOptimize(back_end.map().keyframes.data());
  }
  state.SetItemsProcessed(state.iterations() * keyframes);
}
BENCHMARK(add)->Name("slam/back_end/add")->ArgName("keyframes")->RangeMultiplier(10)->Range(100, 100'000);

}  // namespace
}  // namespace chainslam
