#include "chainslam/registration/icp.hpp"

#include <benchmark/benchmark.h>

#include <ctime>
#include <numbers>
#include <utility>
#include <vector>

#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/thread_pool.hpp"
#include "chainslam/features/fpfh.hpp"
#include "chainslam/registration/gaussian_voxel_map.hpp"
#include "registration_pairs.hpp"
#include "versus.hpp"
#ifdef CHAINSLAM_PEER_SMALL_GICP
#include "registration/peers/small_gicp.hpp"
#endif
#ifdef CHAINSLAM_PEER_PCL
#include "registration/peers/pcl.hpp"
#endif

// Local registration against small_gicp and PCL: voxels of 0.25 m, normals of 10 points, the same settings on both
// sides (20 iterations, steps of 1 mm and 0.1 deg end it). Points and normals are small_gicp's where it takes part.

namespace chainslam {
namespace {

constexpr double voxel = 0.25;
constexpr double tolerance = 0.1 * std::numbers::pi / 180;

/// What small_gicp's point-to-plane factor measures: each coordinate of the offset times that of the normal, where the
/// distance from the plane is their sum.
struct PlaneByAxes {
  static constexpr Surface source_surface = Surface::nothing;
  static constexpr Surface target_surface = Surface::normal;
  static constexpr int residuals_a_pair = 1;

  template <class Number>
  void evaluate(const SurfacePair<Number>& pair, PairTerms<Number>& terms) const {
    const auto& n = pair.target_normal;
    terms.information = {n[0] * n[0], 0.0, 0.0, n[1] * n[1], 0.0, n[2] * n[2]};
    for (std::size_t i = 0; i < 3; ++i) terms.pull[i] = n[i] * n[i] * pair.offset[i];
    const auto& d = pair.offset;
    terms.squared_residual = terms.pull[0] * d[0] + terms.pull[1] * d[1] + terms.pull[2] * d[2];
  }
};
static_assert(SurfaceMetric<PlaneByAxes>);

double max_distance(const bench::RealPair& pair) { return pair.name == "outdoor" ? 1.0 : 2.0; }

/// Both clouds thinned and with normals, in our form and, where it takes part, in small_gicp's.
struct Prepared {
  PointCloud<float> source;
  IndexedCloud<> target;
  GaussianVoxelMap voxels;
#ifdef CHAINSLAM_PEER_SMALL_GICP
  bench::SmallGicpCloud peer_source, peer_target;
#endif
};

#ifdef CHAINSLAM_PEER_SMALL_GICP
PointCloud<float> ours(const bench::SmallGicpCloud& theirs) {
  PointCloud<float> cloud;
  cloud.positions = theirs.positions();
  cloud.normals = theirs.normals();
  return cloud;
}

Prepared prepare(const bench::RealPair& pair) {
  bench::SmallGicpCloud source = bench::small_gicp_prepared(pair.source.positions, voxel);
  bench::SmallGicpCloud target = bench::small_gicp_prepared(pair.target.positions, voxel);
  target.build_voxel_map(1.0);
  GaussianVoxelMap voxels({.neighborhood = 1});  // as small_gicp has it
  voxels.insert(ours(target));
  return {ours(source), IndexedCloud<>(ours(target)), std::move(voxels), std::move(source), std::move(target)};
}
#else
PointCloud<float> thinned(const PointCloud<float>& cloud) {
  PointCloud<float> result = voxel_downsample(cloud, voxel);
  estimate_normals(result, {.neighbors = 10});
  return result;
}

Prepared prepare(const bench::RealPair& pair) {
  PointCloud<float> target = thinned(pair.target);
  GaussianVoxelMap voxels({.neighborhood = 1});  // as small_gicp has it
  voxels.insert(target);
  return {thinned(pair.source), IndexedCloud<>(std::move(target)), std::move(voxels)};
}
#endif

template <class Registration>
Registration configured(const bench::RealPair& pair) {
  return {.max_iterations = 20,
          .max_distance = max_distance(pair),
          .translation_tolerance = 1e-3,
          .rotation_tolerance = tolerance};
}

void count(benchmark::State& state, const bench::RealPair& pair, const SE3d& T, const std::string& prefix = "") {
  const SE3d off = pair.T_target_source.inverse() * T;
  state.counters[prefix + "error_m"] = off.translation().norm();
  state.counters[prefix + "error_deg"] = off.rotation().log().norm() * 180 / std::numbers::pi;
}

void count(benchmark::State& state, const bench::RealPair& pair, const AlignResult& result) {
  count(state, pair, result.T_target_source);
  state.counters["iterations"] = result.iterations;
  state.counters["converged"] = result.converged() ? 1 : 0;
}

#if defined(CHAINSLAM_PEER_SMALL_GICP) || defined(CHAINSLAM_PEER_PCL)
bench::PeerTransform transform(const SE3d& T) { return bench::PeerTransform(T.matrix()); }
SE3d pose(const bench::PeerPose& peer) { return SE3d::from_matrix(peer.T_target_source.matrix()); }
#endif

#ifdef CHAINSLAM_PEER_SMALL_GICP
bench::SmallGicpSettings peer_settings(const bench::RealPair& pair, bool gauss_newton = false) {
  return {.max_distance = max_distance(pair), .gauss_newton = gauss_newton};
}
#endif

/// Alignment alone, everything else made before. Against small_gicp's default optimizer and against its Gauss-Newton.
template <class Registration, class Target>
void align(benchmark::State& state, const bench::RealPair& pair, Target Prepared::*target,
           [[maybe_unused]] int peer_metric) {
  const Prepared prepared = prepare(pair);
  const auto registration = configured<Registration>(pair);
  AlignResult result;
  const auto run = [&] {
    result = registration.align(prepared.source, prepared.*target, pair.guess);
    return result.T_target_source.translation()[0];
  };
#ifdef CHAINSLAM_PEER_SMALL_GICP
  bench::PeerPose peer;
  const auto against = [&](bool gauss_newton) {
    return [&, gauss_newton] {
      peer = bench::small_gicp_align(static_cast<bench::SmallGicpMetric>(peer_metric), prepared.peer_source,
                                     prepared.peer_target, transform(pair.guess), peer_settings(pair, gauss_newton));
      return peer.T_target_source.translation()[0];
    };
  };
  bench::versus(state, run, bench::Peer{"small_gicp_gauss_newton", against(true)},
                bench::Peer{"small_gicp", against(false)});
  (void)against(false)();
  count(state, pair, pose(peer), "small_gicp_");
#else
  bench::versus(state, run);
#endif
  count(state, pair, result);
}

/// A scan against a prepared submap, all that the scan costs included: voxel grid, normals, alignment by GICP. PCL's
/// GICP makes the submap's tree and covariances in each call, too; `clouds_to_pose` has them on both sides.
void scan_to_submap(benchmark::State& state, const bench::RealPair& pair) {
  const Prepared prepared = prepare(pair);
  const auto gicp = configured<Gicp>(pair);
  AlignResult result;
  const auto run = [&] {
    PointCloud<float> scan = voxel_downsample(pair.source, voxel);
    estimate_normals(scan, {.neighbors = 10});
    result = gicp.align(scan, prepared.target, pair.guess);
    return result.T_target_source.translation()[0];
  };
#ifdef CHAINSLAM_PEER_SMALL_GICP
  bench::PeerPose peer;
  const auto small_gicp = [&] {
    peer = bench::small_gicp_scan_to_submap(pair.source.positions, voxel, prepared.peer_target, transform(pair.guess),
                                            peer_settings(pair));
    return peer.T_target_source.translation()[0];
  };
#endif
#ifdef CHAINSLAM_PEER_PCL
  const bench::PclCloud scan(pair.source.positions), submap(prepared.target.cloud().positions);
  bench::PeerPose pcl_pose;
  const auto pcl = [&] {
    pcl_pose =
        bench::pcl_gicp(scan.downsampled(voxel), submap, transform(pair.guess), {.max_distance = max_distance(pair)});
    return pcl_pose.T_target_source.translation()[0];
  };
#endif
#if defined(CHAINSLAM_PEER_SMALL_GICP) && defined(CHAINSLAM_PEER_PCL)
  bench::versus(state, run, bench::Peer{"small_gicp", small_gicp}, bench::Peer{"pcl", pcl});
#elif defined(CHAINSLAM_PEER_SMALL_GICP)
  bench::versus(state, "small_gicp", run, small_gicp);
#elif defined(CHAINSLAM_PEER_PCL)
  bench::versus(state, "pcl", run, pcl);
#else
  bench::versus(state, run);
#endif
#ifdef CHAINSLAM_PEER_SMALL_GICP
  count(state, pair, pose(peer), "small_gicp_");
#endif
#ifdef CHAINSLAM_PEER_PCL
  count(state, pair, pose(pcl_pose), "pcl_");
#endif
  count(state, pair, result);
}

#ifdef CHAINSLAM_PEER_PCL
/// The same from raw clouds, the submap's side included: PCL's GICP makes its trees and covariances in each call.
void clouds_to_pose(benchmark::State& state, const bench::RealPair& pair) {
  const auto gicp = configured<Gicp>(pair);
  AlignResult result;
  const auto run = [&] {
    PointCloud<float> scan = voxel_downsample(pair.source, voxel);
    estimate_normals(scan, {.neighbors = 10});
    result = gicp.align(scan, OrientedOnDemand(voxel_downsample(pair.target, voxel)), pair.guess);
    return result.T_target_source.translation()[0];
  };
  const bench::PclCloud source(pair.source.positions), target(pair.target.positions);
  bench::PeerPose peer;
  bench::versus(state, "pcl", run, [&] {
    peer = bench::pcl_gicp(source.downsampled(voxel), target.downsampled(voxel), transform(pair.guess),
                           {.max_distance = max_distance(pair)});
    return peer.T_target_source.translation()[0];
  });
  count(state, pair, pose(peer), "pcl_");
  count(state, pair, result);
}
#endif

double process_time() {
  timespec time{};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

/// Two threads: the same bits, and how much more processor time they take together than one.
void two_threads(benchmark::State& state, const bench::RealPair& pair) {
  const Prepared prepared = prepare(pair);
  const auto gicp = configured<Gicp>(pair);
  const ThreadPool pool(2);
  std::vector<double> ratios;
  for (auto _ : state) {
    const double start = process_time();
    const AlignResult one = gicp.align(prepared.source, prepared.target, pair.guess);
    const double middle = process_time();
    const double wall = bench::WallTime::now();
    const AlignResult two = gicp.align(prepared.source, prepared.target, pair.guess, pool);
    state.SetIterationTime(bench::WallTime::now() - wall);
    ratios.push_back((process_time() - middle) / (middle - start));
    if (!(one.T_target_source == two.T_target_source && one.hessian == two.hessian))
      return state.SkipWithError("two threads give other bits than one");
  }
  state.counters["cpu_over_one_thread"] = bench::detail::median(ratios);
}

template <class Run>
void add(const char* name, const bench::RealPair& pair, Run&& run) {
  benchmark::RegisterBenchmark(("registration/" + std::string(name) + "/" + pair.name).c_str(),
                               [&pair, run](benchmark::State& state) { run(state, pair); })
      ->UseManualTime()
      ->Unit(benchmark::kMillisecond);
}

[[maybe_unused]] const bool registered = [] {
  enum { point, plane, gicp, vgicp };  // small_gicp's metrics in their order
  for (const bench::RealPair& pair : bench::real_pairs()) {
    add("icp_point_to_point", pair, [](benchmark::State& state, const bench::RealPair& p) {
      align<PointToPointIcp>(state, p, &Prepared::target, point);
    });
    add("icp_point_to_plane", pair, [](benchmark::State& state, const bench::RealPair& p) {
      align<PointToPlaneIcp>(state, p, &Prepared::target, plane);
    });
    add("icp_plane_by_axes", pair, [](benchmark::State& state, const bench::RealPair& p) {
      align<Icp<PlaneByAxes>>(state, p, &Prepared::target, plane);
    });
    add("gicp", pair,
        [](benchmark::State& state, const bench::RealPair& p) { align<Gicp>(state, p, &Prepared::target, gicp); });
    add("vgicp", pair,
        [](benchmark::State& state, const bench::RealPair& p) { align<Vgicp>(state, p, &Prepared::voxels, vgicp); });
    add("scan_to_submap", pair, scan_to_submap);
#ifdef CHAINSLAM_PEER_PCL
    add("clouds_to_pose", pair, clouds_to_pose);
#endif
    add("gicp_two_threads", pair, two_threads);
  }
  return true;
}();

}  // namespace
}  // namespace chainslam
