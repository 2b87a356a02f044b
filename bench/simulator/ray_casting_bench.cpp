#include <benchmark/benchmark.h>

#include <cmath>
#include <map>
#include <numbers>
#include <string>
#include <vector>

#include "simulator/town_drive.hpp"

namespace chainslam::simulator {
namespace {

/// The first session of a preset.
const TownDrive& session(const char* name) {
  static std::map<std::string, TownDrive> sessions;
  const auto found = sessions.find(name);
  if (found != sessions.end()) return found->second;
  return sessions.try_emplace(name, *preset(name, PresetSize::small), 1).first->second;
}

/// The nominal rays of one revolution of the LiDAR, from where the vehicle is at `time`.
std::vector<Ray> rays_at(const TownDrive& drive, double time) {
  const LidarOptions& options = drive.lidar().options();
  const SE3d T_map_lidar = drive.drive().pose(time) * options.T_body_lidar;
  std::vector<Ray> rays;
  for (Index firing = 0; firing < options.firings_per_revolution; ++firing)
    for (Index laser = 0; laser < drive.lidar().lasers(); ++laser) {
      const double azimuth = -2.0 * std::numbers::pi * firing / options.firings_per_revolution;
      const double elevation = drive.lidar().nominal_elevation(laser);
      const Eigen::Vector3d direction(std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth),
                                      std::sin(elevation));
      rays.push_back({T_map_lidar.translation().cast<float>(),
                      (T_map_lidar.rotation() * direction).cast<float>().normalized(),
                      static_cast<float>(options.max_range)});
    }
  return rays;
}

void count_rays(benchmark::State& state, Index rays) {
  state.counters["rays_per_s"] =
      benchmark::Counter(static_cast<double>(state.iterations() * rays), benchmark::Counter::kIsRate);
}

/// Rays alone.
void cast(benchmark::State& state, const char* name) {
  const TownDrive& drive = session(name);
  std::vector<Ray> rays;
  for (double time = 2.0; time < drive.drive().duration(); time += 10.0)
    for (const Ray& ray : rays_at(drive, time)) rays.push_back(ray);
  for (auto _ : state)
    for (const Ray& ray : rays) benchmark::DoNotOptimize(drive.caster().cast(ray));
  count_rays(state, to_index(rays.size()));
}
BENCHMARK_CAPTURE(cast, town, "town")->Name("simulator/ray_caster/town")->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(cast, nclt_like, "nclt-like")->Name("simulator/ray_caster/nclt-like")->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(cast, mars_like, "mars-like")->Name("simulator/ray_caster/mars-like")->Unit(benchmark::kMillisecond);

/// Rays with all that makes a scan of them: poses, traffic, noise, lost returns.
void turn(benchmark::State& state, const char* name) {
  const TownDrive& drive = session(name);
  Index index = 0;
  for (auto _ : state) {
    benchmark::DoNotOptimize(drive.revolution(index));
    index = (index + 37) % drive.scan_count();
  }
  count_rays(state, drive.lidar().options().firings_per_revolution * drive.lidar().lasers());
}
BENCHMARK_CAPTURE(turn, town, "town")->Name("simulator/spinning_lidar/town")->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(turn, nclt_like, "nclt-like")
    ->Name("simulator/spinning_lidar/nclt-like")
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(turn, mars_like, "mars-like")
    ->Name("simulator/spinning_lidar/mars-like")
    ->Unit(benchmark::kMillisecond);

/// Streets, houses and trees of the whole town, and the grid over them.
void build(benchmark::State& state) {
  for (auto _ : state) benchmark::DoNotOptimize(RayCaster(make_town(preset("town")->town, Rng(1)).world));
}
BENCHMARK(build)->Name("simulator/town/build")->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace chainslam::simulator
