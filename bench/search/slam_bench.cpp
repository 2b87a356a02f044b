#include <numeric>

#include "chainslam/search/ikd_tree.hpp"
#include "chainslam/search/voxel_map.hpp"
#include "search/ours.hpp"
#include "search/peers/peers.hpp"
#include "search/slam_run.hpp"

namespace chainslam::bench {
namespace {

using Tree = IkdTree<float, NearestToCenter>;
using Voxels = VoxelMap<float, NearestToCenter>;
Tree make_tree(const Points& points) { return Tree(points, NearestToCenter{map_voxel}); }
Voxels make_voxels(const Points& points) { return Voxels(points, NearestToCenter{map_voxel}); }

/// Points half a metre apart wherever the voxels' faces are.
using SpacedVoxels = VoxelMap<float, VoxelMapOptions>;
SpacedVoxels make_spaced_voxels(const Points& points) {
  return SpacedVoxels(points, {.voxel_size = 2.0, .max_points_per_voxel = 100, .min_spacing = map_voxel});
}

const std::vector<Maker>& ours() {
  static const std::vector<Maker> makers{
      {"ikd_tree", make_ours<Tree, make_tree>},
      {"ikd_tree_batched", make_ours_batched<Tree, make_tree>},
      {"voxel_map", make_ours<Voxels, make_voxels>},
      {"voxel_map_spaced", make_ours<SpacedVoxels, make_spaced_voxels>, Thinning::own},
  };
  return makers;
}

/// Three runs, or one to see that it runs.
const std::vector<SlamRun>& runs() {
  static const std::vector<SlamRun> made = [] {
    static std::vector<Maker> all = ours();
    for (const Maker& peer : peers_that(PeersThat::grow)) all.push_back(peer);
    std::vector<SlamRun> runs;
    for (int i = 0; i < (brief() ? 1 : 3); ++i) runs.emplace_back(all);
    return runs;
  }();
  return made;
}

/// The time that a case counts, for one scan.
using Case = Elapsed (*)(const Series& series, std::size_t scan);

double total(const Series& series, Case what, double Elapsed::*clock = &Elapsed::thread) {
  double sum = 0;
  for (std::size_t i = 0; i < series.first.size(); ++i) sum += what(series, i).*clock;
  return sum;
}

/// The median over the runs.
template <class Value>
double over_runs(Value&& value) {
  std::vector<double> values;
  for (const SlamRun& run : runs()) values.push_back(value(run.series()));
  return detail::median(values);
}

/// The longest step of a walk. A step's time is its median over the runs: a step that is long by itself, is so in each
/// run; one that another program disturbed, is not.
double longest_step(std::size_t place, double Elapsed::*clock) {
  double longest = 0;
  for (std::size_t i = 0; i < walk().steps().size(); ++i)
    longest = std::max(longest, over_runs([&](const auto& series) { return series[place].step(i).*clock; }));
  return longest;
}

/// What ikd-Tree's own thread took.
double helper_ms_per_scan() {
  std::vector<double> values;
  for (const SlamRun& run : runs()) values.push_back(1e3 * run.helpers_seconds());
  return detail::median(values) / static_cast<double>(walk().steps().size());
}

/// A row: the time of each scan, and how much longer the peers took for the whole walk.
/// @param asked  how often the case goes through a scan's points; 0 where they are not its measure
void report(benchmark::State& state, std::size_t place, Case what, int asked = 0) {
  std::vector<double> times;
  for (const SlamRun& run : runs())
    for (std::size_t i = 0; i < run.series()[place].first.size(); ++i)
      if (const Elapsed elapsed = what(run.series()[place], i); elapsed.thread > 0) times.push_back(elapsed.thread);
  if (times.empty()) return state.SkipWithError("nothing of the kind in so short a walk");
  std::size_t next = 0;
  for (auto _ : state) state.SetIterationTime(times[next++ % times.size()]);
  if (asked > 0) {
    std::size_t points = 0;
    for (const Step& step : walk().steps()) points += step.scan.size();
    const double per_scan = static_cast<double>(points) / static_cast<double>(walk().steps().size());
    state.counters["ns_per_point"] =
        1e9 * std::accumulate(times.begin(), times.end(), 0.0) / static_cast<double>(times.size()) / (asked * per_scan);
  }

  const std::size_t first_peer = ours().size();
  const auto count = static_cast<double>(times.size()) / static_cast<double>(runs().size());
  for (std::size_t p = first_peer; p < runs().front().series().size(); ++p) {
    const std::string& name = runs().front().series()[p].name;
    const double theirs = over_runs([&](const auto& series) { return total(series[p], what); });
    if (!(theirs > 0)) continue;
    state.counters["speedup_vs_" + name] =
        over_runs([&](const auto& series) { return total(series[p], what) / total(series[place], what); });
    state.counters[name + "_ms"] = 1e3 * theirs / count;
    if (name != "ikd_tree") continue;  // the one that waits for a thread of its own
    constexpr auto wall = &Elapsed::wall;
    state.counters["wall_speedup_vs_" + name] =
        over_runs([&](const auto& series) { return total(series[p], what, wall) / total(series[place], what, wall); });
  }
}

/// 5-NN of each point of a scan, in its order.
void knn5(benchmark::State& state, std::size_t place) {
  report(
      state, place, [](const Series& series, std::size_t i) { return series.first[i]; }, 1);
}

/// What an iterated filter asks again, three times, the scan having moved a little: seeded by the last answer.
void knn5_seeded(benchmark::State& state, std::size_t place) {
  report(
      state, place, [](const Series& series, std::size_t i) { return series.again[i]; }, 3);
}

/// All four times that an iterated filter asks.
void knn5_iterated(benchmark::State& state, std::size_t place) {
  report(
      state, place,
      [](const Series& series, std::size_t i) {
        Elapsed elapsed = series.again[i];
        if (elapsed.thread > 0) elapsed += series.first[i];
        return elapsed;
      },
      4);
}

void insert(benchmark::State& state, std::size_t place) {
  report(
      state, place, [](const Series& series, std::size_t i) { return series.insert[i]; }, 1);
}

void erase_box(benchmark::State& state, std::size_t place) {
  report(state, place, [](const Series& series, std::size_t i) { return series.erase[i]; });
}

/// Ask, insert and forget; the longest step, too, and what the map weighs.
void step(benchmark::State& state, std::size_t place) {
  report(state, place, [](const Series& series, std::size_t i) { return series.step(i); });
  const auto& series = runs().front().series();
  state.counters["bytes_per_point"] = series[place].bytes / series[place].points;
  const double ours_longest = longest_step(place, &Elapsed::thread);
  const double ours_longest_wall = longest_step(place, &Elapsed::wall);
  state.counters["worst_step_ms"] = 1e3 * ours_longest;
  state.counters["worst_step_wall_ms"] = 1e3 * ours_longest_wall;
  for (std::size_t p = ours().size(); p < series.size(); ++p) {
    const std::string& name = series[p].name;
    state.counters[name + "_bytes_per_point"] = series[p].bytes / series[p].points;
    state.counters[name + "_worst_step_ms"] = 1e3 * longest_step(p, &Elapsed::thread);
    state.counters[name + "_worst_step_wall_ms"] = 1e3 * longest_step(p, &Elapsed::wall);
    state.counters["worst_step_speedup_vs_" + name] = longest_step(p, &Elapsed::thread) / ours_longest;
    if (name != "ikd_tree") continue;
    state.counters["worst_step_wall_speedup_vs_ikd_tree"] = longest_step(p, &Elapsed::wall) / ours_longest_wall;
    state.counters["ikd_tree_helper_ms"] = helper_ms_per_scan();
  }
}

const bool registered = [] {
  for (std::size_t place = 0; place < ours().size(); ++place) {
    std::string name = ours()[place].name, suffix;
    if (const std::size_t batched = name.find("_batched"); batched != std::string::npos) {
      suffix = name.substr(batched);
      name.erase(batched);
    }
    const auto add = [&](const std::string& what, auto run, bool every_scan) {
      const int count = brief() ? 1 : every_scan ? 900 : 30;
      benchmark::RegisterBenchmark(("search/" + name + "/" + what + suffix).c_str(), run, place)
          ->UseManualTime()
          ->Iterations(count)
          ->Unit(benchmark::kMillisecond);
    };
    add("slam_knn5", knn5, true);
    add("slam_knn5_seeded", knn5_seeded, false);
    add("slam_knn5_iterated", knn5_iterated, false);
    if (!suffix.empty()) continue;
    add("slam_insert", insert, true);
    add("slam_erase_box", erase_box, false);
    add("slam_step", step, true);
  }
  return true;
}();

}  // namespace
}  // namespace chainslam::bench
