#include <algorithm>

#include "chainslam/search/ikd_tree.hpp"
#include "chainslam/search/kd_tree.hpp"
#include "search/ours.hpp"
#include "search/peers/peers.hpp"
#include "search/peers/thinned_points.hpp"
#include "search/timing.hpp"
#include "search/workload.hpp"

namespace chainslam::bench {
namespace {

constexpr std::size_t points_in_quarter = 100'000, k = 5;

/// A part of the city as a map holds it, one point in half a metre, 100 000 of them: those nearest the first scan.
const Points& quarter() {
  static const Points made = [] {
    ThinnedPoints map;
    for (const Step& step : walk().steps())
      for (const Eigen::Vector3f& p : step.scan) map.offer(p, [&] { return map.next_slot(); });
    Points points = map.points;
    const auto nearer = [](const Eigen::Vector3f& a, const Eigen::Vector3f& b) {
      return a.squaredNorm() < b.squaredNorm();
    };
    const auto end = points.begin() + static_cast<std::ptrdiff_t>(std::min(points_in_quarter, points.size()));
    std::nth_element(points.begin(), end - 1, points.end(), nearer);
    points.erase(end, points.end());
    return points;
  }();
  return made;
}

/// Quarters side by side, each with noise of its own, in a square of `side` by `side`: density does not change with
/// size.
Eigen::Vector3f corner(int place, int side) {
  constexpr float apart = 400;
  return {apart * static_cast<float>(place % side), apart * static_cast<float>(place / side), 0};
}

Points town(int side) {
  Rng rng(3);
  Points points;
  points.reserve(quarter().size() * static_cast<std::size_t>(side * side));
  for (int place = 0; place < side * side; ++place)
    for (const Eigen::Vector3f& p : quarter()) {
      const Eigen::Vector3d noise(rng.normal(0, 0.02), rng.normal(0, 0.02), rng.normal(0, 0.02));
      points.push_back(p + corner(place, side) + noise.cast<float>());
    }
  return points;
}

/// Sixty scans, each somewhere else in the town.
Points queries(int side) {
  Rng rng(5);
  Points all;
  for (std::size_t i = 0; i < 60; ++i) {
    const Eigen::Vector3f shift = corner(rng.uniform_index(side * side), side);
    for (const Eigen::Vector3f& p : walk().steps()[i % 12].scan) all.push_back(p + shift);
  }
  return all;
}

Points shuffled(Points points) {
  Rng rng(9);
  for (std::size_t i = points.size(); i > 1; --i)
    std::swap(points[i - 1], points[static_cast<std::size_t>(rng.uniform_index(static_cast<Index>(i)))]);
  return points;
}

double growth(Structure& small, Structure& large, const Points& in_small, const Points& in_large,
              std::vector<double>* times = nullptr) {
  std::vector<double> ratios;
  for (int turn = 0; turn < 5; ++turn) {
    double seconds[2];
    for (const int i : {turn % 2, 1 - turn % 2})
      seconds[i] = measure([&] { i == 0 ? small.knn(in_small, k) : large.knn(in_large, k); }).thread;
    ratios.push_back(seconds[1] / seconds[0]);
    if (times != nullptr) times->push_back(seconds[1]);
  }
  return detail::median(ratios);
}

/// 5-NN among 10^7 points against 10^5 of the same density; the bench's time is that among 10^7.
void grow(benchmark::State& state, const Maker& maker) {
  const int side = brief() ? 3 : 10;
  const Points in_small = queries(1), in_large = queries(side);
  std::vector<double> times;
  for (const Maker& each : {maker, Maker{"nanoflann", make_nanoflann_peer}}) {
    const auto small = each.make(), large = each.make();
    small->build(town(1));
    large->build(town(side));
    const bool ours = each.name == maker.name;
    const std::string name = ours ? "" : each.name + "_";
    state.counters[name + "growth"] = growth(*small, *large, in_small, in_large, ours ? &times : nullptr);
    state.counters[name + "growth_random_order"] = growth(*small, *large, shuffled(in_small), shuffled(in_large));
  }
  std::size_t next = 0;
  for (auto _ : state) state.SetIterationTime(times[next++ % times.size()]);
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(in_large.size()));
}

IkdTree<float> make_ikd_tree(const Points& points) { return IkdTree<float>(points); }
KdTree<float> make_kd_tree(const Points& points) { return KdTree<float>(points); }

const bool registered = [] {
  static const std::vector<Maker> makers{
      {"ikd_tree", make_ours<IkdTree<float>, make_ikd_tree>},
      {"kd_tree", make_ours<KdTree<float>, make_kd_tree>},
  };
  for (const Maker& maker : makers) {
    const std::string name = "search/" + maker.name + "/growth";
    benchmark::RegisterBenchmark(name.c_str(), [&](benchmark::State& state) { grow(state, maker); })
        ->UseManualTime()
        ->Iterations(5)
        ->Unit(benchmark::kMillisecond);
  }
  return true;
}();

}  // namespace
}  // namespace chainslam::bench
