#include "chainslam/cloud/voxel_grid.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <unordered_map>
#include <utility>

#include "chainslam/cloud/plane_fit.hpp"
#include "clouds.hpp"
#include "versus.hpp"

namespace chainslam {
namespace {

using bench::ScanPair;
using bench::versus;
using Positions = std::vector<Eigen::Vector3f>;

/// 21 bits an axis: what the usual voxel grids pack a cell into; only right near the origin.
std::uint64_t packed_key(const Eigen::Vector3f& p, float inverse_size) {
  const auto part = [&](float v) {
    return static_cast<std::uint64_t>(static_cast<std::int64_t>(std::floor(v * inverse_size)) + (1 << 20)) & 0x1fffffU;
  };
  return part(p[0]) | part(p[1]) << 21 | part(p[2]) << 42;
}

/// The way of small_gicp and Open3D's legacy code, written plainly: sort by key, then average runs.
Positions by_sorting(const Positions& points, float size) {
  std::vector<std::pair<std::uint64_t, std::uint32_t>> keys;
  keys.reserve(points.size());
  for (std::size_t i = 0; i < points.size(); ++i)
    keys.emplace_back(packed_key(points[i], 1 / size), static_cast<std::uint32_t>(i));
  std::ranges::sort(keys, {}, [](const auto& key) { return key.first; });
  Positions means;
  for (std::size_t begin = 0; begin < keys.size();) {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    std::size_t end = begin;
    for (; end < keys.size() && keys[end].first == keys[begin].first; ++end)
      sum += points[keys[end].second].cast<double>();
    means.push_back((sum / static_cast<double>(end - begin)).cast<float>());
    begin = end;
  }
  return means;
}

/// The way of a first draft: the standard library's hash map.
Positions by_unordered_map(const Positions& points, float size) {
  std::unordered_map<std::uint64_t, std::pair<Eigen::Vector3d, int>> cells;
  for (const Eigen::Vector3f& p : points) {
    auto& cell = cells.try_emplace(packed_key(p, 1 / size), Eigen::Vector3d::Zero(), 0).first->second;
    cell.first += p.cast<double>();
    ++cell.second;
  }
  Positions means;
  for (const auto& entry : cells)
    means.push_back((entry.second.first / static_cast<double>(entry.second.second)).cast<float>());
  return means;
}

std::vector<double> sums(const Positions& points) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3f& p : points) sum += p.cast<double>();
  return {static_cast<double>(points.size()), sum[0], sum[1], sum[2]};
}

void downsample(benchmark::State& state, const ScanPair& pair, double size) {
  const Positions& points = pair.first.positions;
  const auto edge = static_cast<float>(size);
  const auto ours = [&] { return voxel_downsample(points, size).positions; };
  // Sums of tens of thousands of coordinates of both signs: the difference is of rounding.
  bench::require_same_answers(sums(ours()), sums(by_sorting(points, edge)), 1e-5, 1e-2);
  bench::require_same_answers(sums(ours()), sums(by_unordered_map(points, edge)), 1e-5, 1e-2);
  versus(
      state, [&] { return ours().size(); }, bench::Peer{"sorting", [&] { return by_sorting(points, edge).size(); }},
      bench::Peer{"unordered_map", [&] { return by_unordered_map(points, edge).size(); }});
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
  for (const ScanPair& pair : bench::scan_pairs())
    for (const double size : {0.25, 0.5})
      benchmark::RegisterBenchmark(("cloud/voxel_grid/" + pair.name + (size < 0.5 ? "_025m" : "_050m")).c_str(),
                                   [&pair, size](benchmark::State& state) { downsample(state, pair, size); })
          ->UseManualTime()
          ->Unit(benchmark::kMillisecond);
  return true;
}();
BENCHMARK(fit_planes)->Name("cloud/plane_fit/five_points")->Unit(benchmark::kMicrosecond);

}  // namespace
}  // namespace chainslam
