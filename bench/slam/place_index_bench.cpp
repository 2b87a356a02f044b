#include <benchmark/benchmark.h>

#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/features/height_image.hpp"
#include "chainslam/slam/place_index.hpp"
#include "versus.hpp"

namespace chainslam::bench {
namespace {

/// Houses, trees and poles at random within 100 m: 0.25 m between points, 0.1 m of noise.
std::vector<Eigen::Vector3d> neighbourhood(Rng rng) {
  std::vector<Eigen::Vector3d> cloud;
  const auto column = [&](double x, double y, double top) {
    for (const double z : {0.0, top}) cloud.emplace_back(x + rng.normal(0, 0.1), y + rng.normal(0, 0.1), z);
  };
  for (int house = 0; house < 40; ++house) {
    const double x = rng.uniform(-100, 100), y = rng.uniform(-100, 100), heading = rng.uniform(0, 3);
    const double width = rng.uniform(5, 20), depth = rng.uniform(5, 20), top = rng.uniform(2, 6);
    const auto wall = [&](double u, double v) {
      column(x + u * std::cos(heading) - v * std::sin(heading), y + u * std::sin(heading) + v * std::cos(heading), top);
    };
    for (double u = 0; u < width; u += 0.25) wall(u, 0), wall(u, depth);
    for (double v = 0; v < depth; v += 0.25) wall(0, v), wall(width, v);
  }
  for (int pole = 0; pole < 150; ++pole) column(rng.uniform(-100, 100), rng.uniform(-100, 100), rng.uniform(1, 5));
  return cloud;
}

/// Keypoints that lie `distance` metres off along each axis, with other random bits.
std::vector<ImageKeypoint> disturbed(std::vector<ImageKeypoint> keypoints, double distance, int bits, Rng& rng) {
  for (ImageKeypoint& keypoint : keypoints) {
    keypoint.position += Eigen::Vector2d(rng.normal(0, distance), rng.normal(0, distance)).cast<float>();
    for (int k = 0; k < bits; ++k) {
      const Index bit = rng.uniform_index(256);
      keypoint.descriptor[static_cast<std::size_t>(bit / 64)] ^= std::uint64_t{1} << (bit % 64);
    }
  }
  return keypoints;
}

/// Time of one query, the share of queries whose place comes first, and the memory that a place takes.
void query(benchmark::State& state) {
  constexpr Index asked = 50;
  constexpr std::uint64_t drawn = 100;  // the others are like them, but their keypoints lie elsewhere
  const Rng rng(1);
  std::vector<std::vector<ImageKeypoint>> kinds;
  for (std::uint64_t kind = 0; kind < drawn; ++kind)
    kinds.push_back(image_keypoints(height_image(neighbourhood(rng.fork(kind)))));
  std::size_t keypoints = 0;
  std::vector<std::vector<ImageKeypoint>> queries;
  queries.reserve(asked);
  const double before = heap_bytes();
  PlaceIndex index;
  for (Index place = 0; place < static_cast<Index>(state.range(0)); ++place) {
    Rng other = rng.fork(drawn + static_cast<std::uint64_t>(place));
    const auto seen = disturbed(kinds[static_cast<std::size_t>(place) % drawn], 30, 60, other);
    keypoints += seen.size();
    index.add(seen);
    Rng again = rng.fork(1'000'000 + static_cast<std::uint64_t>(place));
    if (place < asked) queries.push_back(disturbed(seen, 0.5, 25, again));
  }
  double held = heap_bytes() - before;
  for (const auto& query : queries) held -= static_cast<double>(query.capacity() * sizeof(ImageKeypoint));
  Index right = 0;
  for (auto _ : state) {
    right = 0;
    const double start = ThreadTime::now();
    for (Index place = 0; place < asked; ++place) {
      const auto found = index.find(queries[static_cast<std::size_t>(place)]);
      right += !found.empty() && found.front().place == place ? 1 : 0;
    }
    state.SetIterationTime((ThreadTime::now() - start) / asked);
  }
  state.counters["right"] = static_cast<double>(right) / asked;
  state.counters["bytes_per_place"] = held / static_cast<double>(state.range(0));
  state.counters["keypoints_per_place"] = static_cast<double>(keypoints) / static_cast<double>(state.range(0));
}
BENCHMARK(query)
    ->Name("slam/place_index/query")
    ->ArgName("places")
    ->Arg(100)
    ->Arg(1000)
    ->Arg(10'000)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);

/// Time to draw a place and find its keypoints.
void describe(benchmark::State& state) {
  const auto cloud = neighbourhood(Rng(1));
  for (auto _ : state) {
    const double start = ThreadTime::now();
    benchmark::DoNotOptimize(image_keypoints(height_image(cloud)));
    state.SetIterationTime(ThreadTime::now() - start);
  }
}
BENCHMARK(describe)->Name("slam/place_index/describe")->UseManualTime()->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace chainslam::bench
