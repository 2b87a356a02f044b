#include <benchmark/benchmark.h>

#include <cmath>
#include <numbers>
#include <vector>

#include "simulator/rig.hpp"
#include "simulator/town_drive.hpp"

namespace chainslam::simulator {
namespace {

const TownDrive& town() {
  static const TownDrive drive(*preset("town"), 1);
  return drive;
}

/// The nominal rays of one revolution of the LiDAR, from where the vehicle is at `time`.
std::vector<Ray> rays_at(double time) {
  const SE3d T_map_lidar = town().drive().pose(time) * nominal_T_body_lidar();
  std::vector<Ray> rays;
  const Index firings = town().lidar().options().firings_per_revolution;
  for (Index firing = 0; firing < firings; ++firing)
    for (Index laser = 0; laser < SpinningLidar::lasers; ++laser) {
      const double azimuth = -2.0 * std::numbers::pi * firing / firings;
      const double elevation = SpinningLidar::nominal_elevation(laser);
      const Eigen::Vector3d direction(std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth),
                                      std::sin(elevation));
      rays.push_back({T_map_lidar.translation().cast<float>(),
                      (T_map_lidar.rotation() * direction).cast<float>().normalized(), 100.0F});
    }
  return rays;
}

/// Rays alone.
void cast(benchmark::State& state) {
  std::vector<Ray> rays;
  for (double time = 2.0; time < town().drive().duration(); time += 10.0)
    for (const Ray& ray : rays_at(time)) rays.push_back(ray);
  for (auto _ : state)
    for (const Ray& ray : rays) benchmark::DoNotOptimize(town().caster().cast(ray));
  state.SetItemsProcessed(state.iterations() * std::ssize(rays));
}
BENCHMARK(cast)->Name("simulator/ray_caster/town")->Unit(benchmark::kMillisecond);

/// Rays with all that makes a scan of them: poses, noise, lost returns. Items are rays.
void turn(benchmark::State& state) {
  Index index = 0;
  for (auto _ : state) {
    benchmark::DoNotOptimize(town().revolution(index));
    index = (index + 37) % town().scan_count();
  }
  state.SetItemsProcessed(state.iterations() * town().lidar().options().firings_per_revolution * SpinningLidar::lasers);
}
BENCHMARK(turn)->Name("simulator/spinning_lidar/town")->Unit(benchmark::kMillisecond);

/// Streets, houses and trees of the whole town, and the grid over them.
void build(benchmark::State& state) {
  for (auto _ : state) benchmark::DoNotOptimize(RayCaster(make_town(preset("town")->town, Rng(1)).world));
}
BENCHMARK(build)->Name("simulator/town/build")->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace chainslam::simulator
