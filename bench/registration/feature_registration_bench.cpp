#include "chainslam/registration/feature_registration.hpp"

#include <benchmark/benchmark.h>

#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "clouds.hpp"

namespace chainslam {
namespace {

void report(benchmark::State& state, const DescribedCloud& source, const DescribedCloud& target,
            const GlobalAlignResult& result) {
  state.counters["source"] = static_cast<double>(source.cloud.size());
  state.counters["target"] = static_cast<double>(target.cloud.size());
  state.counters["matches"] = result.matches;
  state.counters["iterations"] = result.iterations;
  state.counters["fitness_target"] = result.fitness_target;
  state.counters["putative_ratio"] = result.putative_ratio;
}

/// Everything: thinning, normals, features, matches, consensus.
void whole(benchmark::State& state, const bench::ScanPair& pair) {
  const FeatureRegistration<> registration;
  const ThreadPool pool(static_cast<Index>(state.range(0)));
  GlobalAlignResult result;
  for (auto _ : state) benchmark::DoNotOptimize(result = registration.align(pair.second, pair.first, pool));
  report(state, registration.describe(pair.second), registration.describe(pair.first), result);
}

/// What is left once a submap has been described, and kept.
void described(benchmark::State& state, const bench::ScanPair& pair) {
  const FeatureRegistration<> registration;
  const ThreadPool pool(static_cast<Index>(state.range(0)));
  const DescribedCloud source = registration.describe(pair.second), target = registration.describe(pair.first);
  GlobalAlignResult result;
  for (auto _ : state) benchmark::DoNotOptimize(result = registration.align(source, target, pool));
  report(state, source, target, result);
}

/// All hypotheses and none right: the matches are shuffled.
void ransac_in_vain(benchmark::State& state, const bench::ScanPair& pair) {
  const FeatureRegistration<> registration;
  const ThreadPool pool(static_cast<Index>(state.range(0)));
  const DescribedCloud source = registration.describe(pair.second), target = registration.describe(pair.first);
  std::vector<FeatureMatch> matches = match_features(source.features, target.features);
  Rng rng(1);
  for (std::size_t i = matches.size(); i > 1; --i)
    std::swap(matches[i - 1].target, matches[static_cast<std::size_t>(rng.uniform_index(to_index(i)))].target);
  GlobalAlignResult result;
  for (auto _ : state)
    benchmark::DoNotOptimize(result = registration.estimator.align(source.cloud.cloud(), target.cloud, matches, pool));
  report(state, source, target, result);
}

[[maybe_unused]] const bool registered = [] {
  for (const bench::ScanPair& pair : bench::scan_pairs()) {
    const auto add = [&pair](const char* name, void (*run)(benchmark::State&, const bench::ScanPair&)) {
      benchmark::RegisterBenchmark(("registration/" + std::string(name) + "/" + pair.name).c_str(),
                                   [&pair, run](benchmark::State& state) { run(state, pair); })
          ->ArgName("threads")
          ->Arg(1)
          ->Arg(2)
          ->UseRealTime()
          ->Unit(benchmark::kMillisecond);
    };
    add("feature_registration", whole);
    add("feature_registration_described", described);
    add("ransac_in_vain", ransac_in_vain);
  }
  return true;
}();

}  // namespace
}  // namespace chainslam
