#include "chainslam/lie/se3.hpp"

#include <benchmark/benchmark.h>

#include <vector>

#include "chainslam/core/random.hpp"

namespace chainslam {
namespace {

constexpr std::size_t count = 1000;

/// Tangents as scans are apart: metres, and turns of up to a radian about each axis.
const std::vector<Vector6d>& tangents() {
  static const std::vector<Vector6d> made = [] {
    Rng rng(1);
    std::vector<Vector6d> xis(count);
    for (Vector6d& xi : xis)
      for (Eigen::Index i = 0; i < 6; ++i) xi[i] = i < 3 ? rng.uniform(-10, 10) : rng.uniform(-1, 1);
    return xis;
  }();
  return made;
}

const std::vector<SE3d>& poses() {
  static const std::vector<SE3d> made = [] {
    std::vector<SE3d> all;
    for (const Vector6d& xi : tangents()) all.push_back(SE3d::exp(xi));
    return all;
  }();
  return made;
}

/// Calls `run(i)` for a thousand elements; items are calls.
template <class Run>
void thousand(benchmark::State& state, Run&& run) {
  for (auto _ : state)
    for (std::size_t i = 0; i < count; ++i) benchmark::DoNotOptimize(run(i));
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(count));
}

void exp(benchmark::State& state) {
  thousand(state, [&](std::size_t i) { return SE3d::exp(tangents()[i]); });
}

void log(benchmark::State& state) {
  thousand(state, [&](std::size_t i) { return poses()[i].log(); });
}

void compose(benchmark::State& state) {
  thousand(state, [&](std::size_t i) { return poses()[i] * poses()[count - 1 - i]; });
}

/// One pose on many points, as for a scan.
void act(benchmark::State& state) {
  thousand(state, [T = poses().front()](std::size_t i) { return Eigen::Vector3d(T * tangents()[i].head<3>()); });
}

BENCHMARK(exp)->Name("lie/se3/exp")->Unit(benchmark::kMicrosecond);
BENCHMARK(log)->Name("lie/se3/log")->Unit(benchmark::kMicrosecond);
BENCHMARK(compose)->Name("lie/se3/compose")->Unit(benchmark::kMicrosecond);
BENCHMARK(act)->Name("lie/se3/act")->Unit(benchmark::kMicrosecond);

}  // namespace
}  // namespace chainslam
