#include "chainslam/search/kd_tree.hpp"

#include <array>
#include <nanoflann.hpp>

#include "clouds.hpp"
#include "versus.hpp"

namespace chainslam {
namespace {

using bench::ScanPair;
using bench::versus;

/// nanoflann used as its own examples use it, leaf size 10 (its default).
class Nanoflann {
 public:
  struct Adaptor {
    const std::vector<Eigen::Vector3f>* points;
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
  using Tree = nanoflann::KDTreeSingleIndexAdaptor<Metric, Adaptor, 3, std::uint32_t>;

  explicit Nanoflann(const std::vector<Eigen::Vector3f>& points) : adaptor_{&points}, tree_(3, adaptor_, {10}) {}

  std::size_t knn(const Eigen::Vector3f& query, std::size_t k, std::uint32_t* indices, float* distances) const {
    return tree_.knnSearch(query.data(), k, indices, distances);
  }
  std::size_t within(const Eigen::Vector3f& query, float radius,
                     std::vector<std::pair<std::uint32_t, float>>& out) const {
    nanoflann::SearchParams unsorted;
    unsorted.sorted = false;
    return tree_.radiusSearch(query.data(), radius * radius, out, unsorted);
  }

 private:
  Adaptor adaptor_;
  Tree tree_;
};

constexpr std::size_t max_k = 32;

double sum_knn(const KdTree<>& tree, const std::vector<Eigen::Vector3f>& queries, std::size_t k,
               std::vector<double>* each = nullptr) {
  std::array<Neighbor<float>, max_k> out;
  double sum = 0;
  for (const Eigen::Vector3f& query : queries) {
    const Index found = tree.knn(query, std::span(out).first(k));
    sum += static_cast<double>(out[static_cast<std::size_t>(found) - 1].squared_distance);
    for (std::size_t i = 0; each != nullptr && i < k; ++i)
      each->push_back(static_cast<double>(out[i].squared_distance));
  }
  return sum;
}

double sum_knn(const Nanoflann& tree, const std::vector<Eigen::Vector3f>& queries, std::size_t k,
               std::vector<double>* each = nullptr) {
  std::array<std::uint32_t, max_k> indices;
  std::array<float, max_k> distances;
  double sum = 0;
  for (const Eigen::Vector3f& query : queries) {
    const std::size_t found = tree.knn(query, k, indices.data(), distances.data());
    sum += static_cast<double>(distances[found - 1]);
    for (std::size_t i = 0; each != nullptr && i < k; ++i) each->push_back(static_cast<double>(distances[i]));
  }
  return sum;
}

void set_rate(benchmark::State& state, std::size_t items) {
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(items));
}

/// The second scan asks the first for its k nearest, in the order of the scan.
void knn(benchmark::State& state, const ScanPair& pair, std::size_t k) {
  const KdTree<> tree(pair.first);
  const Nanoflann peer(pair.first.positions);
  const auto& queries = pair.second.positions;
  std::vector<double> ours, theirs;
  sum_knn(tree, queries, k, &ours);
  sum_knn(peer, queries, k, &theirs);
  bench::require_same_answers(ours, theirs);
  versus(
      state, "nanoflann", [&] { return sum_knn(tree, queries, k); }, [&] { return sum_knn(peer, queries, k); });
  set_rate(state, queries.size());
}

/// Everything within 0.5 m.
void within(benchmark::State& state, const ScanPair& pair) {
  const KdTree<> tree(pair.first);
  const Nanoflann peer(pair.first.positions);
  const auto& queries = pair.second.positions;
  constexpr float radius = 0.5f;
  std::vector<Neighbor<float>> ours;
  std::vector<std::pair<std::uint32_t, float>> theirs;
  const auto count_ours = [&] {
    std::size_t count = 0;
    for (const Eigen::Vector3f& query : queries) {
      tree.within(query, radius, ours);
      count += ours.size();
    }
    return static_cast<double>(count);
  };
  const auto count_theirs = [&] {
    std::size_t count = 0;
    for (const Eigen::Vector3f& query : queries) count += peer.within(query, radius, theirs);
    return static_cast<double>(count);
  };
  const double found = count_ours();
  bench::require_same_answers(std::array{found}, std::array{count_theirs()}, 1e-6);  // the rim: <= against <
  versus(state, "nanoflann", count_ours, count_theirs);
  set_rate(state, queries.size());
  state.counters["hits_per_query"] = found / static_cast<double>(queries.size());
}

void build(benchmark::State& state, const ScanPair& pair) {
  versus(
      state, "nanoflann", [&] { return KdTree<>(pair.first).size(); },
      [&] {
        const Nanoflann peer(pair.first.positions);
        benchmark::DoNotOptimize(&peer);
        return pair.first.size();
      });
  set_rate(state, pair.first.size());
}

const bool registered = [] {
  for (const ScanPair& pair : bench::scan_pairs()) {
    const std::string name = "search/kd_tree/" + pair.name + "_";
    const auto add = [&](const std::string& what, auto&& run) {
      benchmark::RegisterBenchmark((name + what).c_str(), run)->UseManualTime()->Unit(benchmark::kMillisecond);
    };
    for (const std::size_t k : {1, 5, 20})
      add("knn" + std::to_string(k), [&pair, k](benchmark::State& state) { knn(state, pair, k); });
    add("radius", [&pair](benchmark::State& state) { within(state, pair); });
    add("build", [&pair](benchmark::State& state) { build(state, pair); });
  }
  return true;
}();

}  // namespace
}  // namespace chainslam
