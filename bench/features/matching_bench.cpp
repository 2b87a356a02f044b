#include "chainslam/features/matching.hpp"

#include <nanoflann.hpp>
#include <utility>
#include <vector>

#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/features/fpfh.hpp"
#include "chainslam/features/normals.hpp"
#include "chainslam/search/indexed_cloud.hpp"
#include "clouds.hpp"
#include "versus.hpp"

namespace chainslam {
namespace {

FpfhFeatures describe(const PointCloud<float>& scan) {
  PointCloud<float> cloud = voxel_downsample(scan, 1.0);
  estimate_normals(cloud, {.neighbors = 30, .radius = 2.0});
  const IndexedCloud<> indexed(std::move(cloud));
  return estimate_fpfh(indexed.cloud(), indexed);
}

/// The field's usual way: a k-d tree in 33 dimensions each way.
using FeatureTree = nanoflann::KDTreeEigenMatrixAdaptor<FpfhFeatures, 33, nanoflann::metric_L2, false>;

Eigen::Index nearest(const FeatureTree& tree, const Eigen::Matrix<float, 33, 1>& query) {
  Eigen::Index index = 0;
  float squared_distance = 0;
  nanoflann::KNNResultSet<float, Eigen::Index> result(1);
  result.init(&index, &squared_distance);
  tree.index->findNeighbors(result, query.data(), nanoflann::SearchParams());
  return index;
}

std::vector<FeatureMatch> match_by_trees(const FpfhFeatures& source, const FpfhFeatures& target) {
  const FeatureTree source_tree(33, source), target_tree(33, target);
  std::vector<FeatureMatch> matches;
  for (Eigen::Index i = 0; i < source.cols(); ++i) {
    if (source.col(i).isZero(0)) continue;
    const Eigen::Index there = nearest(target_tree, source.col(i));
    if (nearest(source_tree, target.col(there)) == i)
      matches.push_back({static_cast<Index>(i), static_cast<Index>(there)});
  }
  return matches;
}

/// Mutual matches of the features of two scans, thinned to 1 m.
void matching(benchmark::State& state, const bench::ScanPair& pair) {
  const FpfhFeatures source = describe(pair.second), target = describe(pair.first);
  const auto ours = [&] { return static_cast<double>(match_features(source, target).size()); };
  const auto theirs = [&] { return static_cast<double>(match_by_trees(source, target).size()); };
  bench::require_same_answers(std::array{ours()}, std::array{theirs()}, 2e-3);  // ties
  bench::versus(state, "nanoflann", ours, theirs);
  state.counters["matches"] = ours();
  state.counters["source"] = static_cast<double>(source.cols());
  state.counters["target"] = static_cast<double>(target.cols());
}

const bool registered = [] {
  for (const bench::ScanPair& pair : bench::scan_pairs())
    benchmark::RegisterBenchmark(("features/matching/" + pair.name + "_mutual").c_str(),
                                 [&pair](benchmark::State& state) { matching(state, pair); })
        ->UseManualTime()
        ->Unit(benchmark::kMillisecond);
  return true;
}();

}  // namespace
}  // namespace chainslam
