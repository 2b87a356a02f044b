#include <benchmark/benchmark.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/odometry/lidar_odometry.hpp"
#include "datasets/dataset.hpp"
#include "simulator/rig.hpp"
#include "simulator/town_drive.hpp"
#include "versus.hpp"

namespace chainslam {
namespace {

/// A drive in memory: what its sensors sent, in time order.
struct Recording {
  SE3d T_body_lidar;
  std::vector<Packet> packets;
};

template <class Source>
Recording record(Source& source, const SE3d& T_body_lidar) {
  Recording recording{T_body_lidar, {}};
  while (std::optional<Packet> packet = source.next()) recording.packets.push_back(*std::move(packet));
  return recording;
}

/// Once around a block, with the inertial unit: 32 beams, 480 columns, 25 m of range.
Recording town_small() {
  simulator::TownDrive drive(*simulator::preset("town-small"), 1);
  return record(drive, simulator::nominal_T_body_lidar());
}

/// A data set on disk, such as KITTI's: 64 beams, corrected for motion by its authors, without an inertial unit.
Recording read(const std::filesystem::path& folder) {
  const auto dataset = datasets::open_dataset(folder);
  return record(*dataset, dataset->info().T_body_lidar);
}

double percentile(std::vector<double> values, double part) {
  std::ranges::sort(values);
  return values[static_cast<std::size_t>(part * static_cast<double>(values.size() - 1))];
}

/// The whole drive once; items are frames, times are processor time on one thread. The time of a frame holds that of
/// the inertial samples before it.
void drive(benchmark::State& state, const Recording& recording) {
  std::vector<double> milliseconds;
  for (auto _ : state) {
    LidarOdometry<> odometry({.T_body_lidar = recording.T_body_lidar});
    double whole = 0, frame = 0;
    for (const Packet& packet : recording.packets) {
      const double start = bench::ThreadTime::now();
      const bool answered = odometry.process(packet).has_value();
      frame += bench::ThreadTime::now() - start;
      if (!answered) continue;
      milliseconds.push_back(1e3 * frame);
      whole += frame;
      frame = 0;
    }
    if (odometry.counts().frames == 0 || odometry.counts().lost_scans > 0)
      throw std::runtime_error("odometry lost its way: its time says nothing");
    state.SetIterationTime(whole);
  }
  state.SetItemsProcessed(static_cast<std::int64_t>(milliseconds.size()));
  state.counters["p50_ms"] = percentile(milliseconds, 0.50);
  state.counters["p99_ms"] = percentile(milliseconds, 0.99);
}

template <class Load>
void add(const char* name, const Load& load) {
  benchmark::RegisterBenchmark(name, [load](benchmark::State& state) { drive(state, load()); })
      ->Iterations(1)
      ->UseManualTime()
      ->Unit(benchmark::kMillisecond);
}

const bool registered = [] {
  if (const char* root = std::getenv("CHAINSLAM_UNPACKED_DATA")) {
    const auto folder = std::filesystem::path(root) / "kitti00_first101/kitti00_first101";
    if (std::filesystem::exists(folder)) add("odometry/frame/kitti00_first101", [folder] { return read(folder); });
  }
  add("odometry/frame/town-small", town_small);
  return true;
}();

}  // namespace
}  // namespace chainslam
