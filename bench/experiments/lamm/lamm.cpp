#include "lamm.hpp"

#include <chrono>
#include <cstddef>
#include <utility>

#include "descriptor_table.hpp"

namespace chainslam::lamm {

namespace {

class Stopwatch {
 public:
  /// Seconds since the last call, or since it was made.
  double lap() {
    const auto now = std::chrono::steady_clock::now();
    return std::chrono::duration<double>(now - std::exchange(last_, now)).count();
  }

 private:
  std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
};

using AllClouds = std::vector<std::vector<KeyCloud>>;

AllClouds describe(std::span<const Drive> drives, const Options& options, const ThreadPool& threads, Counts& counts) {
  AllClouds clouds;
  Index frames_before = 0;
  for (const Drive& drive : drives) {
    clouds.push_back(
        key_clouds(drive, options.clouds, options.place, frames_before, options.frames_per_number, threads));
    frames_before += drive.frames();
    counts.key_clouds += to_index(clouds.back().size());
    for (const KeyCloud& cloud : clouds.back()) {
      counts.keypoints += to_index(cloud.place->keypoints.size());
      counts.triangles += to_index(cloud.place->triangles.size());
    }
  }
  return clouds;
}

/// The loops of each drive with itself and with those before it, filtered pair by pair.
std::vector<Loop> search(std::span<const Drive> drives, const AllClouds& clouds, const Options& options,
                         const ThreadPool& threads, Counts& counts) {
  std::vector<DescriptorTable> tables(drives.size(), DescriptorTable(options.table));
  std::vector<Loop> all;
  for (std::size_t source = 0; source < drives.size(); ++source) {
    for (const KeyCloud& cloud : clouds[source]) tables[source].add(cloud.place);
    for (std::size_t target = 0; target <= source; ++target) {
      ++counts.pairs;
      std::vector<Loop> loops = find_loops(to_index(source), to_index(target), clouds[source], clouds[target],
                                           tables[target], options.search, options.verification, threads);
      filter_loops(loops, drives, options.filter, options.search.turned_start);
      all.insert(all.end(), loops.begin(), loops.end());
    }
  }
  return all;
}

}  // namespace

Options as_released() {
  Options options;
  options.search.min_gap_any = 101;
  options.search.turned_start = false;
  options.verification.min_overlap = 0.3;
  options.filter.few_radius = 0;
  options.graph.frames_a_loop = 10;
  options.graph.placed = false;
  options.graph.own_start = false;
  options.graph.max_iterations = 11;
  options.graph.damped = false;
  return options;
}

Result merge(std::span<const Drive> drives, const Options& options, const ThreadPool& threads) {
  Result result;
  Stopwatch watch;
  const AllClouds clouds = describe(drives, options, threads, result.counts);
  result.counts.describe_seconds = watch.lap();
  result.loops = search(drives, clouds, options, threads, result.counts);
  result.counts.search_seconds = watch.lap();
  result.drives = optimize_drives(drives, result.loops, options.graph);
  result.counts.optimize_seconds = watch.lap();
  return result;
}

}  // namespace chainslam::lamm
