#include <array>

#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/search/ikd_tree.hpp"
#include "chainslam/search/kd_tree.hpp"
#include "clouds.hpp"
#include "search/ours.hpp"
#include "search/peers/peers.hpp"
#include "search/timing.hpp"
#include "search/workload.hpp"

namespace chainslam::bench {
namespace {

IkdTree<float> make_ikd_tree(const Points& points) { return IkdTree<float>(points); }
KdTree<float> make_kd_tree(const Points& points) { return KdTree<float>(points); }

const std::vector<Maker>& ours() {
  static const std::vector<Maker> makers{
      {"ikd_tree", make_ours<IkdTree<float>, make_ikd_tree>},
      {"kd_tree", make_ours<KdTree<float>, make_kd_tree>},
  };
  return makers;
}

/// The scans as they come, and the first pair thinned to one point in 0.25 m, as registration takes them.
const std::vector<ScanPair>& pairs() {
  static const std::vector<ScanPair> made = [] {
    std::vector<ScanPair> pairs = scan_pairs();
    const ScanPair raw = pairs.front();
    const auto thinned = [](const PointCloud<float>& cloud) { return voxel_downsample(cloud, 0.25, VoxelMode::first); };
    pairs.insert(pairs.begin() + 1, {raw.name + "_025m", thinned(raw.first), thinned(raw.second)});
    return pairs;
  }();
  return made;
}

std::vector<Maker> against_peers(const Maker& maker) {
  std::vector<Maker> all{maker};
  for (const Maker& peer : peers_that(PeersThat::hold_a_scan)) all.push_back(peer);
  return all;
}

std::vector<std::unique_ptr<Structure>> built(const std::vector<Maker>& makers, const Points& points) {
  std::vector<std::unique_ptr<Structure>> structures;
  for (const Maker& maker : makers) {
    structures.push_back(maker.make());
    structures.back()->build(points);
  }
  return structures;
}

std::vector<double> as_doubles(const std::vector<float>& values) { return {values.begin(), values.end()}; }

/// The second scan asks the first for its k nearest, in the order of the scan.
void knn(benchmark::State& state, const Maker& maker, const ScanPair& pair, std::size_t k) {
  const std::vector<Maker> makers = against_peers(maker);
  const auto structures = built(makers, pair.first.positions);
  const Points& queries = pair.second.positions;
  for (const auto& structure : structures) structure->knn(queries, k);
  const std::vector<double> answers = as_doubles(structures.front()->squared_distances());
  for (const auto& structure : structures) require_same_answers(answers, as_doubles(structure->squared_distances()));
  contest(state, makers, [&](std::size_t i) { return measure([&] { structures[i]->knn(queries, k); }).thread; });
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(queries.size()));
}

/// The nearest of the second scan's points, as registration asks again when the scan has moved by centimetres: ours
/// starts from the last answer, peers from nothing.
void nearest_again(benchmark::State& state, const Maker& maker, const ScanPair& pair) {
  const std::vector<Maker> makers = against_peers(maker);
  const auto structures = built(makers, pair.first.positions);
  const Points& scan = pair.second.positions;
  const std::array<Points, 2> queries{scan, moved_a_little(scan, Eigen::Vector3f::Zero(), 1)};
  for (const auto& structure : structures) {
    structure->knn(queries[1], 1);
    structure->knn_again(queries[0], 1);
  }
  const std::vector<double> answers = as_doubles(structures.front()->squared_distances());
  for (const auto& structure : structures) require_same_answers(answers, as_doubles(structure->squared_distances()));
  std::vector<std::size_t> asked(makers.size(), 0);
  contest(state, makers,
          [&](std::size_t i) { return measure([&] { structures[i]->knn_again(queries[++asked[i] % 2], 1); }).thread; });
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(scan.size()));
}

/// Everything within 0.5 m.
void within(benchmark::State& state, const Maker& maker, const ScanPair& pair) {
  std::vector<Maker> makers = against_peers(maker);
  std::erase_if(makers, [](const Maker& peer) { return !peer.finds_within; });
  const auto structures = built(makers, pair.first.positions);
  const Points& queries = pair.second.positions;
  constexpr float radius = 0.5f;
  const auto found = static_cast<double>(structures.front()->within(queries, radius));
  for (const auto& structure : structures)  // the rim: some take <, others <=
    require_same_answers(std::array{found}, std::array{static_cast<double>(structure->within(queries, radius))}, 1e-6);
  contest(state, makers, [&](std::size_t i) {
    return measure([&] { benchmark::DoNotOptimize(structures[i]->within(queries, radius)); }).thread;
  });
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(queries.size()));
  state.counters["hits_per_query"] = found / static_cast<double>(queries.size());
}

/// From nothing to ready for the first query. Making an empty structure and taking it down is not charged.
void build(benchmark::State& state, const Maker& maker, const ScanPair& pair) {
  const std::vector<Maker> makers = against_peers(maker);
  const Points& points = pair.first.positions;
  for (const Maker& each : makers) {
    const double held = heap_bytes();
    const auto structure = each.make();
    structure->build(points);
    const std::string name = &each == &makers.front() ? "" : each.name + "_";
    state.counters[name + "bytes_per_point"] = (heap_bytes() - held) / static_cast<double>(points.size());
  }
  contest(state, makers, [&](std::size_t i) {
    const auto structure = makers[i].make();
    return measure([&] { structure->build(points); }).thread;
  });
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(points.size()));
}

const bool registered = [] {
  for (const Maker& maker : ours())
    for (const ScanPair& pair : pairs()) {
      const auto add = [&](const std::string& what, auto run) {
        const std::string name = "search/" + maker.name + "/" + what;
        benchmark::RegisterBenchmark(name.c_str(), run)->UseManualTime()->Unit(benchmark::kMillisecond);
      };
      for (const std::size_t k : {1U, 5U, 20U})
        add(pair.name + "_knn" + std::to_string(k), [&, k](benchmark::State& state) { knn(state, maker, pair, k); });
      const std::string prefix = &pair == &pairs().front() ? "" : pair.name + "_";
      add(prefix + "radius", [&](benchmark::State& state) { within(state, maker, pair); });
      add(prefix + "build", [&](benchmark::State& state) { build(state, maker, pair); });
      if (maker.name != "kd_tree") continue;  // what registration asks of it
      add(prefix + "nn1_cold", [&](benchmark::State& state) { knn(state, maker, pair, 1); });
      add(prefix + "nn2_cold", [&](benchmark::State& state) { knn(state, maker, pair, 2); });
      add(prefix + "nn1_warm", [&](benchmark::State& state) { nearest_again(state, maker, pair); });
    }
  return true;
}();

}  // namespace
}  // namespace chainslam::bench
