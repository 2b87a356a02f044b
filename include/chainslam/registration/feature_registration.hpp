#pragma once

#include <Eigen/Core>
#include <concepts>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/compiled.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/features/fpfh.hpp"
#include "chainslam/features/matching.hpp"
#include "chainslam/features/normals.hpp"
#include "chainslam/registration/concepts.hpp"
#include "chainslam/registration/ransac.hpp"
#include "chainslam/search/indexed_cloud.hpp"
#include "chainslam/search/kd_tree.hpp"

namespace chainslam {

/// Finds the pose that putative matches agree on: `align(source, target, matches, executor)`, as `Ransac` does.
template <class E>
concept ConsensusEstimator = requires(const E& estimator, const PointCloud<float>& source, const IndexedCloud<>& target,
                                      std::span<const FeatureMatch> matches, const Serial& executor) {
  { estimator.align(source, target, matches, executor) } -> std::same_as<GlobalAlignResult>;
};
static_assert(ConsensusEstimator<Ransac>);

/// A cloud made ready for being found: downsampled, with normals, a search and a feature for each point.
struct DescribedCloud {
  IndexedCloud<> cloud;   ///< downsampled, with normals
  FpfhFeatures features;  ///< one column for each point of `cloud`
};

/// Aligns two clouds without a guess by what their surroundings look like: downsamples them, estimates normals and
/// FPFH, matches these and finds the pose that the matches agree on. The defaults are the paper's for merging submaps.
///
/// Accepting a pose is up to the caller. On real submaps (a courtyard walked twice, three cars' streets;
/// half submaps sought in whole ones) with these defaults: all 102 pairs up to 10 m apart came out right, with
/// fitness_target 0.30 to 1.08 and putative_ratio from 0.14; wrong poses, all but a few by chance between different
/// places, reached 0.52, where a straight street was slid along itself, but a putative_ratio of 0.024 at most.
template <class Estimator = Ransac>
struct FeatureRegistration {
  static_assert(ConsensusEstimator<Estimator>,
                "FeatureRegistration: Estimator needs `GlobalAlignResult align(source, target, matches, executor) "
                "const`, as in Ransac; see chainslam/registration/ransac.hpp");

  double voxel_size = 1.0;                                ///< metres
  NormalOptions normals{.neighbors = 30, .radius = 2.0};  ///< how normals are estimated
  FpfhOptions features{};                                 ///< which neighbours describe a point
  MatchOptions matching{};                                ///< which features are matched
  [[no_unique_address]] Estimator estimator{};            ///< finds the pose from the matches

  /// Downsamples and describes a cloud. Keep the result where one cloud meets several.
  ///
  /// @param points  metres; NaN points are left out. If they carry normals, these say which side of a surface was seen;
  ///                else it is the side of the frame's origin. That side must be the same in clouds that are compared.
  /// @throws std::invalid_argument if an option makes no sense.
  template <Cloud Points, Executor Exec = Serial>
  [[nodiscard]] [[gnu::cold]] DescribedCloud describe(const Points& points, const Exec& executor = {}) const;

  /// Both at once: what one thread does for a cloud, two do for two.
  template <Cloud Source, Cloud Target, Executor Exec = Serial>
  [[nodiscard]] [[gnu::cold]] std::pair<DescribedCloud, DescribedCloud> describe_both(const Source& source,
                                                                                      const Target& target,
                                                                                      const Exec& executor = {}) const;

  /// @param deadline  for an estimator that takes one; past it, the best so far is the answer.
  /// @returns T_target_source with its figures, which count downsampled points; bit-identical for any executor.
  /// @throws std::invalid_argument if an option makes no sense.
  template <Executor Exec = Serial>
  [[nodiscard]] GlobalAlignResult align(const DescribedCloud& source, const DescribedCloud& target,
                                        const Exec& executor = {}, const Deadline& deadline = {}) const;

  /// The same for clouds as they come; see `describe`.
  template <Cloud Source, Cloud Target, Executor Exec = Serial>
  [[nodiscard]] [[gnu::cold]] GlobalAlignResult align(const Source& source, const Target& target,
                                                      const Exec& executor = {}, const Deadline& deadline = {}) const;

 private:
  /// One point a voxel, and the normals that came with them, taken off.
  struct ThinnedCloud {
    PointCloud<float> cloud;
    std::vector<Eigen::Vector3f> seen_sides;
    KdTree<float> tree;
  };

  template <Cloud Points>
  [[nodiscard]] [[gnu::cold]] ThinnedCloud thin(const Points& points) const;

  template <Executor Exec>
  [[nodiscard]] [[gnu::cold]] DescribedCloud describe(ThinnedCloud thinned, const Exec& executor) const;
};
static_assert(GlobalRegistration<FeatureRegistration<>, PointCloud<float>, PointCloud<float>>);

template <class Estimator>
template <Cloud Points, Executor Exec>
DescribedCloud FeatureRegistration<Estimator>::describe(const Points& points, const Exec& executor) const {
  return describe(thin(points), executor);
}

template <class Estimator>
template <Cloud Source, Cloud Target, Executor Exec>
std::pair<DescribedCloud, DescribedCloud> FeatureRegistration<Estimator>::describe_both(const Source& source,
                                                                                        const Target& target,
                                                                                        const Exec& executor) const {
  ThinnedCloud thin_source, thin_target;
  call_both(
      executor, [&] { thin_source = thin(source); }, [&] { thin_target = thin(target); });
  return {describe(std::move(thin_source), executor), describe(std::move(thin_target), executor)};
}

template <class Estimator>
template <Executor Exec>
GlobalAlignResult FeatureRegistration<Estimator>::align(const DescribedCloud& source, const DescribedCloud& target,
                                                        const Exec& executor, const Deadline& deadline) const {
  constexpr std::size_t least_points = 3;
  if (source.cloud.size() < least_points || target.cloud.size() < least_points) return {};
  const std::vector<FeatureMatch> matches = match_features(source.features, target.features, matching, executor);
  if constexpr (requires { estimator.align(source.cloud.cloud(), target.cloud, matches, executor, deadline); })
    return estimator.align(source.cloud.cloud(), target.cloud, matches, executor, deadline);
  else
    return estimator.align(source.cloud.cloud(), target.cloud, matches, executor);
}

template <class Estimator>
template <Cloud Source, Cloud Target, Executor Exec>
GlobalAlignResult FeatureRegistration<Estimator>::align(const Source& source, const Target& target,
                                                        const Exec& executor, const Deadline& deadline) const {
  const auto described = describe_both(source, target, executor);
  return align(described.first, described.second, executor, deadline);
}

template <class Estimator>
template <Cloud Points>
typename FeatureRegistration<Estimator>::ThinnedCloud FeatureRegistration<Estimator>::thin(const Points& points) const {
  ThinnedCloud thinned{.cloud = voxel_downsample(points, voxel_size), .seen_sides = {}, .tree = {}};
  thinned.seen_sides = std::move(thinned.cloud.normals);
  thinned.cloud.normals.clear();
  thinned.tree = KdTree<float>(thinned.cloud);
  return thinned;
}

template <class Estimator>
template <Executor Exec>
DescribedCloud FeatureRegistration<Estimator>::describe(ThinnedCloud thinned, const Exec& executor) const {
  PointCloud<float>& cloud = thinned.cloud;
  const Neighborhoods near(cloud, thinned.tree, features.radius, features.max_neighbors, executor);
  if (normals.radius <= features.radius)
    estimate_normals(cloud, near, normals, Eigen::Vector3d::Zero(), executor);
  else
    detail::estimate_in_tree(cloud, thinned.tree, normals, Eigen::Vector3d::Zero(), executor);
  for (std::size_t i = 0; i < thinned.seen_sides.size(); ++i)
    if (cloud.normals[i].dot(thinned.seen_sides[i]) < 0) cloud.normals[i] = negative(cloud.normals[i]);
  FpfhFeatures described = estimate_fpfh(cloud, near, features.blend, executor);
  return {IndexedCloud<>(std::move(cloud), std::move(thinned.tree)), std::move(described)};
}

#ifdef CHAINSLAM_COMPILED
extern template GlobalAlignResult FeatureRegistration<>::align(const PointCloud<float>&, const PointCloud<float>&,
                                                               const Serial&, const Deadline&) const;
extern template GlobalAlignResult FeatureRegistration<>::align(const PointCloud<float>&, const PointCloud<float>&,
                                                               const ThreadPool&, const Deadline&) const;
#endif

}  // namespace chainslam
