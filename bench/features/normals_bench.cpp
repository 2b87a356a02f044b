#include "chainslam/features/normals.hpp"

#include <Eigen/Eigenvalues>
#include <nanoflann.hpp>

#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/search/nanoflann_tree.hpp"
#include "clouds.hpp"
#include "versus.hpp"

namespace chainslam {
namespace {

using bench::ScanPair;
using bench::versus;

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

/// Normals from ten neighbours, trees built before.
void normals(benchmark::State& state, const ScanPair& pair) {
  PointCloud<float> cloud = voxel_downsample(pair.first, 0.25);
  const KdTree<> tree(cloud);
  const NanoflannTree<> peer(cloud);
  std::vector<Eigen::Vector3f> theirs(cloud.size());
  const auto by_us = [&] {
    const NormalEstimates estimates = estimate_normals(cloud, tree, {.neighbors = 10});
    double sum = 0;
    for (const float curvature : estimates.curvature) sum += static_cast<double>(curvature);
    return sum;
  };
  const auto by_eigen = [&] { return normals_by_eigen(peer, cloud, 10, theirs); };
  bench::require_same_answers(std::array{by_us()}, std::array{by_eigen()}, 1e-3);  // ties in neighbours; lines
  versus(state, "nanoflann_eigen", by_us, by_eigen);
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(cloud.size()));
}

const bool registered = [] {
  for (const ScanPair& pair : bench::scan_pairs())
    benchmark::RegisterBenchmark(("features/normals/" + pair.name + "_10").c_str(),
                                 [&pair](benchmark::State& state) { normals(state, pair); })
        ->UseManualTime()
        ->Unit(benchmark::kMillisecond);
  return true;
}();

}  // namespace
}  // namespace chainslam
