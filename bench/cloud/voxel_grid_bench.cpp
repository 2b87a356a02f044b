#include "chainslam/cloud/voxel_grid.hpp"

#include <array>
#include <cmath>
#include <cstdint>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include "chainslam/cloud/plane_fit.hpp"
#include "clouds.hpp"
#include "registration_pairs.hpp"
#include "versus.hpp"
#ifdef CHAINSLAM_PEER_SMALL_GICP
#include "registration/peers/small_gicp.hpp"
#endif
#ifdef CHAINSLAM_PEER_PCL
#include "registration/peers/pcl.hpp"
#endif
#ifdef CHAINSLAM_PEER_OPEN3D
#include "registration/peers/open3d.hpp"
#endif

namespace chainslam {
namespace {

using bench::versus;
using Positions = std::vector<Eigen::Vector3f>;

/// The way of a first draft: the standard library's hash map; 21 bits an axis in a key, right near the origin.
Positions by_unordered_map(const Positions& points, float size) {
  const auto part = [&](float v) {
    return static_cast<std::uint64_t>(static_cast<std::int64_t>(std::floor(v / size)) + (1 << 20)) & 0x1fffffU;
  };
  std::unordered_map<std::uint64_t, std::pair<Eigen::Vector3d, int>> cells;
  for (const Eigen::Vector3f& p : points) {
    const std::uint64_t key = part(p[0]) | part(p[1]) << 21 | part(p[2]) << 42;
    auto& cell = cells.try_emplace(key, Eigen::Vector3d::Zero(), 0).first->second;
    cell.first += p.cast<double>();
    ++cell.second;
  }
  Positions means;
  for (const auto& entry : cells)
    means.push_back((entry.second.first / static_cast<double>(entry.second.second)).cast<float>());
  return means;
}

[[maybe_unused]] std::vector<double> sums(const Positions& points) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3f& p : points) sum += p.cast<double>();
  return {static_cast<double>(points.size()), sum[0], sum[1], sum[2]};
}

/// Peers differ from us where their cells do (Open3D counts them from the cloud's lowest corner): the number of voxels
/// then differs a little.
void require_as_many(std::size_t ours, std::size_t theirs, double share) {
  bench::require_same_answers(std::array{static_cast<double>(ours)}, std::array{static_cast<double>(theirs)}, share);
}

void downsample(benchmark::State& state, const PointCloud<float>& cloud, double size) {
  const Positions& points = cloud.positions;
  const auto ours = [&] { return voxel_downsample(points, size).size(); };
  require_as_many(ours(), by_unordered_map(points, static_cast<float>(size)).size(), 1e-3);
#ifdef CHAINSLAM_PEER_SMALL_GICP
  const bench::SmallGicpCloud small_gicp(points);
  // The same cells, in double.
  bench::require_same_answers(sums(voxel_downsample(points, size).positions),
                              sums(small_gicp.downsampled(size).positions()), 1e-5, 1e-2);
#endif
#ifdef CHAINSLAM_PEER_PCL
  const bench::PclCloud pcl(points);
  require_as_many(ours(), pcl.downsampled(size).size(), 1e-3);  // its cells are reckoned in float
#endif
#ifdef CHAINSLAM_PEER_OPEN3D
  const bench::Open3dCloud open3d(points);
  require_as_many(ours(), open3d.downsampled(size).size(), 0.2);
#endif
  versus(state, ours,
         bench::Peer{"unordered_map", [&] { return by_unordered_map(points, static_cast<float>(size)).size(); }}
#ifdef CHAINSLAM_PEER_SMALL_GICP
         ,
         bench::Peer{"small_gicp", [&] { return small_gicp.downsampled(size).size(); }}
#endif
#ifdef CHAINSLAM_PEER_PCL
         ,
         bench::Peer{"pcl", [&] { return pcl.downsampled(size).size(); }}
#endif
#ifdef CHAINSLAM_PEER_OPEN3D
         ,
         bench::Peer{"open3d", [&] { return open3d.downsampled(size).size(); }}
#endif
  );
  state.counters["voxels"] = static_cast<double>(ours());
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(points.size()));
}

/// A plane through five points, as odometry fits one for each point: here a thousand of them.
void fit_planes(benchmark::State& state) {
  Rng rng(1);
  std::vector<Eigen::Matrix<float, 3, 5>> sets(1000);
  for (auto& points : sets)
    points = Eigen::Matrix<float, 3, 5>::NullaryExpr([&](Eigen::Index row, Eigen::Index) {
      return static_cast<float>(row == 2 ? 0.01 * rng.normal() : rng.uniform(-0.5, 0.5));
    });
  for (auto _ : state) {
    double sum = 0;
    for (const auto& points : sets) sum += fit_plane(points).eigenvalues[0];
    benchmark::DoNotOptimize(sum);
  }
  state.SetItemsProcessed(state.iterations() * 1000);
}

const bool registered = [] {
  const auto add = [](const std::string& name, const PointCloud<float>& cloud) {
    for (const double size : {0.25, 0.5})
      benchmark::RegisterBenchmark(("cloud/voxel_grid/" + name + (size < 0.5 ? "_025m" : "_050m")).c_str(),
                                   [&cloud, size](benchmark::State& state) { downsample(state, cloud, size); })
          ->UseManualTime()
          ->Unit(benchmark::kMillisecond);
  };
  for (const bench::RealPair& pair : bench::real_pairs()) add(pair.name, pair.target);
  add("city", bench::scan_pairs().back().first);
  return true;
}();
BENCHMARK(fit_planes)->Name("cloud/plane_fit/five_points")->Unit(benchmark::kMicrosecond);

}  // namespace
}  // namespace chainslam
