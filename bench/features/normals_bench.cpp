#include "chainslam/features/normals.hpp"

#include <Eigen/Eigenvalues>
#include <array>
#include <nanoflann.hpp>
#include <string>

#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/thread_pool.hpp"
#include "chainslam/search/nanoflann_tree.hpp"
#include "clouds.hpp"
#include "registration_pairs.hpp"
#include "search/timing.hpp"
#include "versus.hpp"
#ifdef CHAINSLAM_PEER_SMALL_GICP
#include "registration/peers/small_gicp.hpp"
#endif
#ifdef CHAINSLAM_PEER_PCL
#include "registration/peers/pcl.hpp"
#endif
#ifdef CHAINSLAM_PEER_OPEN3D
#include "registration/peers/open3d.hpp"
#endif

namespace chainslam {
namespace {

using bench::versus;

constexpr NormalOptions ten{.neighbors = 10, .covariances = true};

/// The usual way: nanoflann's neighbours, the covariance, Eigen's direct solver.
double normals_by_eigen(const NanoflannTree<>& tree, const PointCloud<float>& cloud, std::size_t k,
                        std::vector<Eigen::Vector3f>& normals) {
  std::vector<Neighbor<float>> neighbors(k);
  double curvature = 0;
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    (void)tree.knn(cloud.positions[i], neighbors);
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    for (const auto& neighbor : neighbors) mean += tree.position(neighbor.index).cast<double>();
    mean /= static_cast<double>(k);
    Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
    for (const auto& neighbor : neighbors) {
      const Eigen::Vector3d d = tree.position(neighbor.index).cast<double>() - mean;
      covariance += d * d.transpose();
    }
    Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen;
    eigen.computeDirect(covariance);
    normals[i] = eigen.eigenvectors().col(0).cast<float>();
    curvature += eigen.eigenvalues()[0] / eigen.eigenvalues().sum();
  }
  return curvature;
}

/// The share of points whose normals differ by less than a degree, or a line has none with us: at least 0.98, since
/// neighbours as far as the tenth may be chosen otherwise, and lines of points have no normal of their own.
[[maybe_unused]] void require_same_normals(const std::vector<Eigen::Vector3f>& ours,
                                           const std::vector<Eigen::Vector3f>& theirs) {
  std::size_t same = 0;
  for (std::size_t i = 0; i < ours.size(); ++i)
    same += ours[i].isZero(0) || std::abs(ours[i].dot(theirs[i])) > 0.99985f ? 1U : 0U;
  if (static_cast<double>(same) < 0.98 * static_cast<double>(ours.size()))
    throw std::runtime_error("normals differ from the peer's at " + std::to_string(ours.size() - same) + " points");
}

/// Normals and covariances from ten neighbours, trees built before; PCL and Open3D build theirs and give normals alone.
void normals(benchmark::State& state, const PointCloud<float>& scan) {
  PointCloud<float> cloud = voxel_downsample(scan.positions, 0.25);
  const KdTree<> tree(cloud);
  const NanoflannTree<> nanoflann(cloud);
  std::vector<Eigen::Vector3f> theirs(cloud.size());
  const auto by_us = [&] {
    const NormalEstimates estimates = estimate_normals(cloud, tree, ten);
    double sum = 0;
    for (const float curvature : estimates.curvature) sum += static_cast<double>(curvature);
    return sum;
  };
  const auto by_eigen = [&] { return normals_by_eigen(nanoflann, cloud, 10, theirs); };
  bench::require_same_answers(std::array{by_us()}, std::array{by_eigen()}, 1e-3);  // ties in neighbours; lines
#ifdef CHAINSLAM_PEER_SMALL_GICP
  bench::SmallGicpCloud small_gicp(cloud.positions);
  small_gicp.build_tree();
  const auto by_small_gicp = [&] {
    small_gicp.estimate_normals_and_covariances(10);
    return small_gicp.size();
  };
  by_small_gicp();
  require_same_normals(cloud.normals, small_gicp.normals());
#endif
#ifdef CHAINSLAM_PEER_PCL
  bench::PclCloud pcl(cloud.positions);
  const auto by_pcl = [&] {
    pcl.estimate_normals(10, 0);
    return pcl.size();
  };
  by_pcl();
  require_same_normals(cloud.normals, pcl.normals());
#endif
#ifdef CHAINSLAM_PEER_OPEN3D
  bench::Open3dCloud open3d(cloud.positions);
  const auto by_open3d = [&] {
    open3d.estimate_normals(10, 1e3);
    return open3d.size();
  };
  by_open3d();
  require_same_normals(cloud.normals, open3d.normals());
#endif
  versus(state, by_us, bench::Peer{"nanoflann_eigen", by_eigen}
#ifdef CHAINSLAM_PEER_SMALL_GICP
         ,
         bench::Peer{"small_gicp", by_small_gicp}
#endif
#ifdef CHAINSLAM_PEER_PCL
         ,
         bench::Peer{"pcl", by_pcl}
#endif
#ifdef CHAINSLAM_PEER_OPEN3D
         ,
         bench::Peer{"open3d", by_open3d}
#endif
  );
  state.counters["points"] = static_cast<double>(cloud.size());
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(cloud.size()));
}

/// What two threads cost beside one: `cpu_of_two`, the processor time of both over that of one, and whether the bits
/// are the same.
void two_threads(benchmark::State& state, const PointCloud<float>& scan) {
  PointCloud<float> one = voxel_downsample(scan.positions, 0.25), two = one;
  const KdTree<> tree(one);
  const ThreadPool pool(2);
  std::vector<double> ratios;
  for (auto _ : state) {
    double begin = bench::ThreadTime::now();
    estimate_normals(one, tree, ten);
    const double alone = bench::ThreadTime::now() - begin;
    begin = bench::ThreadTime::now() + bench::helpers_time();
    estimate_normals(two, tree, ten, Eigen::Vector3d::Zero(), pool);
    const double both = bench::ThreadTime::now() + bench::helpers_time() - begin;
    state.SetIterationTime(both);
    ratios.push_back(both / alone);
  }
  if (one.normals != two.normals) throw std::runtime_error("two threads give other bits than one");
  state.counters["cpu_of_two"] = bench::detail::median(ratios);
}

const bool registered = [] {
  const auto add = [](const std::string& name, const PointCloud<float>& cloud,
                      void (*run)(benchmark::State&, const PointCloud<float>&)) {
    benchmark::RegisterBenchmark(("features/" + name).c_str(),
                                 [&cloud, run](benchmark::State& state) { run(state, cloud); })
        ->UseManualTime()
        ->Unit(benchmark::kMillisecond);
  };
  for (const bench::RealPair& pair : bench::real_pairs()) {
    add("normals/" + pair.name, pair.target, normals);
    add("normals_two_threads/" + pair.name, pair.target, two_threads);
  }
  add("normals/city", bench::scan_pairs().back().first, normals);
  return true;
}();

}  // namespace
}  // namespace chainslam
