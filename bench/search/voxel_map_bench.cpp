#include "chainslam/search/voxel_map.hpp"

#include <array>

// g++ 12 takes the boxes of nanoflann's empty dynamic trees, which are copied unset, for an error.
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#include <nanoflann.hpp>
#pragma GCC diagnostic pop

#include "chainslam/cloud/voxel_grid.hpp"
#include "clouds.hpp"
#include "versus.hpp"

namespace chainslam {
namespace {

using bench::versus;
using Positions = std::vector<Eigen::Vector3f>;

/// What LiDAR odometry keeps: points half a metre apart.
constexpr VoxelMapOptions options{.voxel_size = 2.0, .max_points_per_voxel = 100, .min_spacing = 0.5};
constexpr int scans_in_map = 60;
constexpr std::size_t neighbors = 5;

/// A walk through the city: scans as odometry gives them to the map, one point for each half metre.
const std::vector<Positions>& walk() {
  static const std::vector<Positions> scans = [] {
    const bench::City city;
    std::vector<Positions> made;
    for (int step = 0; step <= scans_in_map; ++step) made.push_back(voxel_downsample(city.scan(step), 0.5).positions);
    return made;
  }();
  return scans;
}

std::size_t points_in_walk() {
  std::size_t count = 0;
  for (int step = 0; step < scans_in_map; ++step) count += walk()[static_cast<std::size_t>(step)].size();
  return count;
}

VoxelMap<> map_of_walk() {
  VoxelMap<> map(options);
  for (int step = 0; step < scans_in_map; ++step) map.insert(walk()[static_cast<std::size_t>(step)]);
  return map;
}

struct Adaptor {
  const Positions* points;
  [[nodiscard]] std::size_t kdtree_get_point_count() const { return points->size(); }
  [[nodiscard]] float kdtree_get_pt(std::size_t i, std::size_t axis) const {
    return (*points)[i][static_cast<Eigen::Index>(axis)];
  }
  template <class Box>
  bool kdtree_get_bbox(Box&) const {
    return false;
  }
};
using Metric = nanoflann::L2_Simple_Adaptor<float, Adaptor, float, std::uint32_t>;
using StaticTree = nanoflann::KDTreeSingleIndexAdaptor<Metric, Adaptor, 3, std::uint32_t>;
using DynamicTree = nanoflann::KDTreeSingleIndexDynamicAdaptor<Metric, Adaptor, 3, std::uint32_t>;

double sum_knn(const VoxelMap<>& map, const Positions& queries) {
  std::array<Neighbor<float>, neighbors> out;
  double sum = 0;
  for (const Eigen::Vector3f& query : queries)
    if (map.knn(query, out, 2.0f) == static_cast<Index>(neighbors))
      sum += static_cast<double>(out.back().squared_distance);
  return sum;
}

double sum_knn(const StaticTree& tree, const Positions& queries) {
  std::array<std::uint32_t, neighbors> indices;
  std::array<float, neighbors> distances;
  double sum = 0;
  for (const Eigen::Vector3f& query : queries)
    if (tree.knnSearch(query.data(), neighbors, indices.data(), distances.data()) == neighbors &&
        distances.back() <= 4.0f)
      sum += static_cast<double>(distances.back());
  return sum;
}

/// Five neighbours within 2 m for each point of the next scan; the peer's tree over the same points is not charged for
/// being built anew after every scan, which a map that grows would need.
void knn(benchmark::State& state) {
  const VoxelMap<> map = map_of_walk();
  Positions points;
  map.for_each_point([&](Index, const Eigen::Vector3f& p) { points.push_back(p); });
  const Adaptor adaptor{&points};
  const StaticTree tree(3, adaptor, {10});
  const Positions& queries = walk().back();
  bench::require_same_answers(std::array{sum_knn(map, queries)}, std::array{sum_knn(tree, queries)}, 1e-5);
  versus(
      state, "nanoflann", [&] { return sum_knn(map, queries); }, [&] { return sum_knn(tree, queries); });
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(queries.size()));
  state.counters["points"] = static_cast<double>(map.size());
  state.counters["bytes_per_point"] = static_cast<double>(map.memory()) / static_cast<double>(map.size());
}

/// 60 scans into an empty map. The peer keeps the same points by the same rule: it asks its tree for the nearest point
/// and adds what is half a metre from it.
void insert(benchmark::State& state) {
  const auto theirs = [] {
    Positions points;
    points.reserve(points_in_walk());
    const Adaptor adaptor{&points};
    DynamicTree tree(3, adaptor, {10}, points_in_walk());
    constexpr auto spacing = static_cast<float>(options.min_spacing);
    for (std::size_t step = 0; step < scans_in_map; ++step) {
      for (const Eigen::Vector3f& p : walk()[step]) {
        std::uint32_t nearest = 0;
        float distance = std::numeric_limits<float>::infinity();
        nanoflann::KNNResultSet<float, std::uint32_t> result(1);
        result.init(&nearest, &distance);
        if (!points.empty()) tree.findNeighbors(result, p.data(), nanoflann::SearchParams());
        if (distance < spacing * spacing) continue;
        points.push_back(p);
        const auto added = static_cast<std::uint32_t>(points.size() - 1);
        tree.addPoints(added, added);
      }
    }
    return points.size();
  };
  const std::size_t kept = map_of_walk().size();
  bench::require_same_answers(std::array{static_cast<double>(kept)}, std::array{static_cast<double>(theirs())}, 1e-4);
  versus(
      state, "nanoflann_dynamic", [] { return map_of_walk().size(); }, theirs);
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(points_in_walk()));
  state.counters["kept"] = static_cast<double>(kept);
}

/// A step of odometry: five neighbours for each point, insert the scan, forget what is farther than 60 m. The peer
/// is a map in a vector of which a tree is built anew at each step, with the thinning and the forgetting for nothing.
void step(benchmark::State& state) {
  const auto ours = [] {
    VoxelMap<> map(options);
    double sum = 0;
    for (int i = 0; i < scans_in_map; ++i) {
      const Positions& scan = walk()[static_cast<std::size_t>(i)];
      sum += sum_knn(map, scan);
      map.insert(scan);
      map.erase_farther_than(bench::City::position(i).cast<float>(), 60.0f);
    }
    return sum;
  };
  std::vector<Positions> maps;
  {
    VoxelMap<> map(options);
    for (int i = 0; i < scans_in_map; ++i) {
      Positions& points = maps.emplace_back();
      map.for_each_point([&](Index, const Eigen::Vector3f& p) { points.push_back(p); });
      map.insert(walk()[static_cast<std::size_t>(i)]);
      map.erase_farther_than(bench::City::position(i).cast<float>(), 60.0f);
    }
  }
  const auto theirs = [&] {
    double sum = 0;
    for (std::size_t i = 1; i < scans_in_map; ++i) {
      const Adaptor adaptor{&maps[i]};
      const StaticTree tree(3, adaptor, {10});
      sum += sum_knn(tree, walk()[i]);
    }
    return sum;
  };
  bench::require_same_answers(std::array{ours()}, std::array{theirs()}, 1e-5);
  versus(state, "nanoflann_rebuilt", ours, theirs);
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(points_in_walk()));
}

BENCHMARK(knn)->Name("search/voxel_map/city_knn5")->UseManualTime()->Unit(benchmark::kMillisecond);
BENCHMARK(insert)->Name("search/voxel_map/city_insert")->UseManualTime()->Unit(benchmark::kMillisecond);
BENCHMARK(step)->Name("search/voxel_map/city_step")->UseManualTime()->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace chainslam
