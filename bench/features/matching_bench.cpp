#include "chainslam/features/matching.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <nanoflann.hpp>
#include <numbers>
#include <stdexcept>
#include <utility>
#include <vector>

#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/features/fpfh.hpp"
#include "chainslam/features/normals.hpp"
#include "chainslam/search/kd_tree.hpp"
#include "clouds.hpp"
#include "versus.hpp"
#ifdef CHAINSLAM_PEER_KISS_MATCHER
#include "registration/peers/kiss_matcher.hpp"
#endif
#ifdef CHAINSLAM_PEER_OPEN3D
#include "registration/peers/open3d.hpp"
#endif

namespace chainslam {
namespace {

/// The points of a sector of 200 degrees about the sensor, thinned to 0.5 m, and their features: about 5000.
struct Described {
  PointCloud<float> cloud;
  FpfhFeatures features;
};

Described describe(const PointCloud<float>& scan, const Eigen::Vector3d& sensor) {
  PointCloud<float> sector;
  for (const Eigen::Vector3f& p : scan.positions) {
    const double azimuth = std::atan2(p.y() - sensor.y(), p.x() - sensor.x());
    if (std::abs(azimuth) <= 100 * std::numbers::pi / 180) sector.positions.push_back(p);
  }
  if (sector.empty()) throw std::runtime_error("there are no points in the sector");
  Described described{voxel_downsample(sector, 0.5), {}};
  const Neighborhoods near(described.cloud, KdTree<float>(described.cloud), 2.5, 0);
  estimate_normals(described.cloud, near, {.neighbors = 0, .radius = 1.5});
  described.features = estimate_fpfh(described.cloud, near);
  return described;
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

#ifdef CHAINSLAM_PEER_KISS_MATCHER
/// Our features as KISS-Matcher takes them: all match the same numbers.
bench::KissMatcherFeatures for_kiss_matcher(const Described& described) {
  bench::KissMatcherFeatures features;
  for (Eigen::Index i = 0; i < described.features.cols(); ++i) {
    if (described.features.col(i).isZero(0)) continue;
    features.positions.push_back(described.cloud.positions[static_cast<std::size_t>(i)]);
    std::copy_n(described.features.col(i).data(), 33, features.features.emplace_back().begin());
  }
  return features;
}
#endif

/// Mutual matches of the features of two scans' sectors.
void matching(benchmark::State& state, const bench::ScanPair& pair) {
  const auto sensor = [&](int scan) -> Eigen::Vector3d {
    return pair.name == "city" ? bench::City::position(scan) : Eigen::Vector3d::Zero();
  };
  const Described source = describe(pair.second, sensor(1)), target = describe(pair.first, sensor(0));
  const auto ours = [&] { return static_cast<double>(match_features(source.features, target.features).size()); };
  const auto theirs = [&] { return static_cast<double>(match_by_trees(source.features, target.features).size()); };
  bench::require_same_answers(std::array{ours()}, std::array{theirs()},
                              2e-3);  // ties
#ifdef CHAINSLAM_PEER_KISS_MATCHER
  const bench::KissMatcherFeatures kiss_source = for_kiss_matcher(source), kiss_target = for_kiss_matcher(target);
#endif
#ifdef CHAINSLAM_PEER_OPEN3D
  // It matches features of its own: as many numbers, of the same points.
  bench::Open3dCloud open3d_source(source.cloud.positions), open3d_target(target.cloud.positions);
  for (bench::Open3dCloud* cloud : {&open3d_source, &open3d_target}) {
    cloud->estimate_normals(30, 1.5);
    cloud->estimate_fpfh(2.5);
  }
#endif
  bench::versus(
      state, ours, bench::Peer{"nanoflann", theirs}
#ifdef CHAINSLAM_PEER_KISS_MATCHER
      ,
      bench::Peer{
          "kiss_matcher",
          [&] { return static_cast<double>(bench::kiss_matcher_matches(kiss_source, kiss_target, false).size()); }}
#endif
#ifdef CHAINSLAM_PEER_OPEN3D
      ,
      bench::Peer{"open3d",
                  [&] { return static_cast<double>(bench::open3d_matches(open3d_source, open3d_target).size()); }}
#endif
  );
  state.counters["matches"] = ours();
  state.counters["source"] = static_cast<double>(source.features.cols());
  state.counters["target"] = static_cast<double>(target.features.cols());
}

[[maybe_unused]] const bool matching_registered = [] {
  for (const bench::ScanPair& pair : bench::scan_pairs())
    benchmark::RegisterBenchmark(("features/matching/" + pair.name).c_str(),
                                 [&pair](benchmark::State& state) { matching(state, pair); })
        ->UseManualTime()
        ->Unit(benchmark::kMillisecond);
  return true;
}();

}  // namespace
}  // namespace chainslam
