#include <benchmark/benchmark.h>

#include <algorithm>
#include <array>
#include <cstddef>
#include <span>
#include <stdexcept>
#include <utility>
#include <vector>

#include "chainslam/cloud/plane_fit.hpp"
#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/random.hpp"
#include "chainslam/odometry/deskew.hpp"
#include "chainslam/odometry/lidar_inertial_odometry.hpp"
#include "chainslam/search/ikd_tree.hpp"
#include "clouds.hpp"
#include "versus.hpp"

namespace chainslam {
namespace {

/// The made city's scans in the body frame, thinned to half a metre: FAST-LIO2's usual input, 8 400 points each.
struct CityWalk {
  std::vector<SE3d> poses;
  std::vector<PointCloud<float>> scans;
};

const CityWalk& city_walk() {
  static const CityWalk walk = [] {
    const bench::City city;
    CityWalk made;
    for (int step = 0; step < 100; ++step) {
      made.poses.emplace_back(SO3d(), bench::City::position(step));
      made.scans.push_back(voxel_downsample(transformed(city.scan(step), made.poses.back().inverse()), 0.5));
    }
    return made;
  }();
  return walk;
}

double percentile_of(std::vector<double> values, double part) {
  std::ranges::sort(values);
  return values[static_cast<std::size_t>(part * static_cast<double>(values.size() - 1))];
}

/// Match, solve and map insertion of each scan from a prediction 5 cm and 0.17 degrees off, on one thread, without
/// de-skew and voxel filter.
template <class Map, class Kernel>
void update(benchmark::State& state,
            const LidarInertialOdometryOptions<Kernel, typename LocalMap<Map>::Downsampling>& options) {
  const CityWalk& walk = city_walk();
  std::vector<double> milliseconds;
  double points = 0, iterations = 0;
  for (auto _ : state) {
    Rng rng(1);
    LocalMap<Map> map(options.map, options.local_map);
    map.extend(walk.scans[0], walk.poses[0]);
    double whole = 0;
    for (std::size_t i = 1; i < walk.scans.size(); ++i) {
      InertialState::Tangent off = InertialState::Tangent::Zero();
      for (int k = 0; k < 3; ++k) off[k] = rng.normal(0, 0.05 / 1.7);
      for (int k = 3; k < 6; ++k) off[k] = rng.normal(0, 0.003 / 1.7);
      InertialState x;
      x.get<Inertial::position>() = R3d(walk.poses[i].translation());
      InertialState::Tangent variance = InertialState::Tangent::Constant(1e-4);
      variance.head<3>().setConstant(2.5e-3);
      Ieskf<InertialState, ImuProcess> filter(x.retract(off), variance.asDiagonal());
      const double start = bench::ThreadTime::now();
      const detail::ScanPrior prior{.state = filter.state(), .error = options.min_error, .variance = 0.0025 * 25};
      detail::ScanMeasurement measurement(walk.scans[i], map.points(), options.scan_to_map, options.scan, prior,
                                          Serial{});
      const auto report = filter.update(measurement, options.iteration);
      map.extend(walk.scans[i], T_odom_body(filter.state()));
      const double elapsed = bench::ThreadTime::now() - start;
      if (!report.accepted() || (T_odom_body(filter.state()).translation() - walk.poses[i].translation()).norm() > 0.5)
        throw std::runtime_error("the filter lost its way: its time says nothing");
      whole += elapsed;
      milliseconds.push_back(1e3 * elapsed);
      points += static_cast<double>(walk.scans[i].size());
      iterations += report.iterations;
    }
    state.SetIterationTime(whole);
  }
  const double frames = static_cast<double>(milliseconds.size());
  state.SetItemsProcessed(static_cast<std::int64_t>(milliseconds.size()));
  state.counters["p50_ms"] = percentile_of(milliseconds, 0.50);
  state.counters["p99_ms"] = percentile_of(milliseconds, 0.99);
  state.counters["points"] = points / frames;
  state.counters["iterations"] = iterations / frames;
}

void update_voxel_map(benchmark::State& state) { update<VoxelMap<float>, GemanMcClure>(state, {}); }
void update_ikd_tree(benchmark::State& state) {
  update<IkdTree<float, NearestToCenter>, GemanMcClure>(state, {.map = {.voxel_size = 0.5}});
}
void update_fast_lio2(benchmark::State& state) {
  update<IkdTree<float, NearestToCenter>, Trivial>(state, fast_lio2_options());
}

/// One reading of an inertial unit through the filter: state and 26 x 26 covariance.
void propagation(benchmark::State& state) {
  Ieskf<InertialState, ImuProcess> filter(InertialState(), 1e-4 * InertialState::Jacobian::Identity());
  const ImuInput input{.gyro = {0.1, -0.2, 0.3}, .accel = {0.1, 0.2, 9.8}};
  for (auto _ : state) {
    filter.predict(input, 1e-6);
    benchmark::DoNotOptimize(filter);
  }
  state.SetItemsProcessed(state.iterations());
}

/// A raw sweep of 100 000 points brought to its end.
void deskewing(benchmark::State& state) {
  Rng rng(2);
  PointCloud<float> sweep;
  for (int i = 0; i < 100'000; ++i) {
    sweep.positions.emplace_back(Eigen::Vector3d(rng.normal(0, 20), rng.normal(0, 20), rng.normal(0, 5)).cast<float>());
    sweep.time_offsets.push_back(static_cast<float>(i * 1e-6));
  }
  Vector6d twist;
  twist << 10, 0, 0, 0.1, 0, 1;
  const SweepMotion motion = SweepMotion::constant_twist(0.1, twist);
  for (auto _ : state) benchmark::DoNotOptimize(deskew(sweep, motion));
  state.SetItemsProcessed(state.iterations() * 100'000);
}

/// The plane through five points, in closed form.
void plane_of_five(benchmark::State& state) {
  Rng rng(3);
  std::vector<std::array<Eigen::Vector3d, 5>> sets(1000);
  for (auto& set : sets)
    for (auto& p : set) p = Eigen::Vector3d(rng.normal(0, 0.5), rng.normal(0, 0.5), rng.normal(0, 0.01));
  for (auto _ : state)
    for (const auto& set : sets) benchmark::DoNotOptimize(fit_plane(std::span<const Eigen::Vector3d>(set)));
  state.SetItemsProcessed(state.iterations() * 1000);
}

BENCHMARK(update_voxel_map)
    ->Name("odometry/frame/update/voxel_map")
    ->Iterations(1)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);
BENCHMARK(update_ikd_tree)
    ->Name("odometry/frame/update/ikd_tree")
    ->Iterations(1)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);
BENCHMARK(update_fast_lio2)
    ->Name("odometry/frame/update/fast_lio2")
    ->Iterations(1)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);
BENCHMARK(propagation)->Name("odometry/propagation");
BENCHMARK(deskewing)->Name("odometry/deskew")->Unit(benchmark::kMillisecond);
BENCHMARK(plane_of_five)->Name("odometry/plane_fit");

}  // namespace
}  // namespace chainslam
