#include "chainslam/registration/icp.hpp"

#include <benchmark/benchmark.h>

#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/thread_pool.hpp"
#include "clouds.hpp"

namespace chainslam {
namespace {

/// Source points and indexed target with normals; voxels of 0.25 m, as registration benches in the field take them.
struct Prepared {
  PointCloud<float> source;
  IndexedCloud<> target;
};

Prepared prepare(const bench::ScanPair& pair) {
  PointCloud<float> target = voxel_downsample(pair.first, 0.25);
  estimate_normals(target, {.neighbors = 10});
  return {voxel_downsample(pair.second, 0.25), IndexedCloud<>(std::move(target))};
}

/// Alignment alone, from the identity, index and normals made before. `matches` counts source points times passes, a
/// second.
template <class Registration>
void align_pair(benchmark::State& state, const Registration& registration, const bench::ScanPair& pair) {
  const Prepared prepared = prepare(pair);
  const ThreadPool pool(static_cast<Index>(state.range(0)));
  AlignResult result;
  for (auto _ : state) {
    result = registration.align(prepared.source, prepared.target, SE3d(), pool);
    benchmark::DoNotOptimize(result);
  }
  const double matches = static_cast<double>(prepared.source.size()) * (result.iterations + 1);
  state.counters["iterations"] = result.iterations;
  state.counters["points"] = static_cast<double>(prepared.source.size());
  state.counters["rms_m"] = std::sqrt(result.mean_squared_residual);
  state.counters["inlier_ratio"] = result.inlier_ratio;
  state.counters["matches"] = benchmark::Counter(matches, benchmark::Counter::kIsIterationInvariantRate);
}

/// Normals and index made in the same go.
void align_clouds(benchmark::State& state, const bench::ScanPair& pair) {
  const PointCloud<float> source = voxel_downsample(pair.second, 0.25);
  const PointCloud<float> target = voxel_downsample(pair.first, 0.25);
  for (auto _ : state) benchmark::DoNotOptimize(align(source, target.positions));
}

[[maybe_unused]] const bool registered = [] {
  for (const bench::ScanPair& pair : bench::scan_pairs()) {
    const auto add = [&pair](const char* name, const auto& registration) {
      benchmark::RegisterBenchmark(
          ("registration/icp/" + std::string(name) + "/" + pair.name).c_str(),
          [&pair, registration](benchmark::State& state) { align_pair(state, registration, pair); })
          ->ArgName("threads")
          ->Arg(1)
          ->Arg(2)
          ->UseRealTime()
          ->Unit(benchmark::kMillisecond);
    };
    add("plane", PointToPlaneIcp{.max_distance = 2.0});
    add("plane_huber", Icp<PointToPlane, Huber>{.max_distance = 2.0, .kernel = {.width = 0.1}});
    add("point", PointToPointIcp{.max_distance = 2.0});
    benchmark::RegisterBenchmark(("registration/align_clouds/" + pair.name).c_str(), [&pair](benchmark::State& state) {
      align_clouds(state, pair);
    })->Unit(benchmark::kMillisecond);
  }
  return true;
}();

}  // namespace
}  // namespace chainslam
