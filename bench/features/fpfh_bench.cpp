#include "chainslam/features/fpfh.hpp"

#include <benchmark/benchmark.h>

#include <utility>
#include <vector>

#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/features/normals.hpp"
#include "chainslam/search/kd_tree.hpp"
#include "clouds.hpp"
#include "versus.hpp"
#ifdef CHAINSLAM_PEER_KISS_MATCHER
#include "registration/peers/kiss_matcher.hpp"
#endif
#ifdef CHAINSLAM_PEER_OPEN3D
#include "registration/peers/open3d.hpp"
#endif
#ifdef CHAINSLAM_PEER_PCL
#include "registration/peers/pcl.hpp"
#endif

namespace chainslam {
namespace {

/// What a peer does; how many points it described.
template <class PeerCloud>
double described(const std::vector<Eigen::Vector3f>& points, int neighbors) {
  PeerCloud cloud(points);
  cloud.estimate_normals(neighbors, 1.5);
  cloud.estimate_fpfh(2.5);
  return static_cast<double>(cloud.size());
}

/// Normals (within 1.5 m) and features (within 2.5 m) of a scan thinned to 0.5
/// m, their search included. What is summed up only shows that it was made:
/// definitions differ (see `FpfhBlend`); the test of FPFH compares.
void fpfh(benchmark::State& state, const bench::ScanPair& pair) {
  const PointCloud<float> thinned = voxel_downsample(pair.first, 0.5);
  const auto ours = [&] {
    PointCloud<float> cloud = thinned;
    const Neighborhoods near(cloud, KdTree<float>(cloud), 2.5, 0);
    estimate_normals(cloud, near, {.neighbors = 0, .radius = 1.5});
    return static_cast<double>(estimate_fpfh(cloud, near).sum());
  };
  bench::versus(
      state, ours
#ifdef CHAINSLAM_PEER_KISS_MATCHER
      ,
      bench::Peer{
          "kiss_matcher",
          [&] { return static_cast<double>(bench::kiss_matcher_features(thinned.positions, 0.5).features.size()); }}
#endif
#ifdef CHAINSLAM_PEER_OPEN3D
      ,
      bench::Peer{"open3d", [&] { return described<bench::Open3dCloud>(thinned.positions, 30); }}
#endif
#ifdef CHAINSLAM_PEER_PCL
      ,
      bench::Peer{"pcl", [&] { return described<bench::PclCloud>(thinned.positions, 0); }}
#endif
  );
  state.counters["points"] = static_cast<double>(thinned.size());
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(thinned.size()));
}

[[maybe_unused]] const bool fpfh_registered = [] {
  for (const bench::ScanPair& pair : bench::scan_pairs())
    benchmark::RegisterBenchmark(("features/fpfh/" + pair.name).c_str(),
                                 [&pair](benchmark::State& state) { fpfh(state, pair); })
        ->UseManualTime()
        ->Unit(benchmark::kMillisecond);
  return true;
}();

}  // namespace
}  // namespace chainslam
