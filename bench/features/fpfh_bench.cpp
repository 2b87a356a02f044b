#include "chainslam/features/fpfh.hpp"

#include <benchmark/benchmark.h>

#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/thread_pool.hpp"
#include "chainslam/features/normals.hpp"
#include "chainslam/search/indexed_cloud.hpp"
#include "clouds.hpp"

namespace chainslam {
namespace {

/// Features of a scan thinned to 1 m, as submaps are for merging; tree and normals made before.
void fpfh(benchmark::State& state, const bench::ScanPair& pair) {
  PointCloud<float> cloud = voxel_downsample(pair.first, 1.0);
  estimate_normals(cloud, {.neighbors = 30, .radius = 2.0});
  const IndexedCloud<> indexed(std::move(cloud));
  const ThreadPool pool(static_cast<Index>(state.range(0)));
  for (auto _ : state) benchmark::DoNotOptimize(estimate_fpfh(indexed.cloud(), indexed, {}, pool));
  state.counters["points"] = static_cast<double>(indexed.size());
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(indexed.size()));
}

const bool registered = [] {
  for (const bench::ScanPair& pair : bench::scan_pairs())
    benchmark::RegisterBenchmark(("features/fpfh/" + pair.name).c_str(),
                                 [&pair](benchmark::State& state) { fpfh(state, pair); })
        ->ArgName("threads")
        ->Arg(1)
        ->Arg(2)
        ->UseRealTime()
        ->Unit(benchmark::kMillisecond);
  return true;
}();

}  // namespace
}  // namespace chainslam
