#pragma once

#include <algorithm>
#include <concepts>
#include <cstddef>
#include <optional>
#include <utility>
#include <vector>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/deadline.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/registration/coarse_to_fine.hpp"
#include "chainslam/registration/concepts.hpp"
#include "chainslam/registration/feature_registration.hpp"
#include "chainslam/registration/graph_consensus.hpp"
#include "chainslam/registration/icp.hpp"
#include "chainslam/registration/verifier.hpp"

namespace chainslam {

/// One pose that matches spoke for, refined and checked.
struct VerifiedPose {
  GlobalAlignResult result;   ///< at the refined pose; `found` if it was accepted, else `refused`
  Verification verification;  ///< what spoke for and against it
};

/// Poses from matches: `gather(source, target, matches)` and `hypotheses(points, count, executor, deadline)`, as
/// `GraphConsensus` gives them.
template <class E>
concept HypothesisEstimator = ConsensusEstimator<E> &&
    requires(const E& estimator, const MatchedPoints& points, Index count, const Serial& executor,
             const Deadline& deadline) {
  { estimator.hypotheses(points, count, executor, deadline) } -> std::same_as<std::vector<Hypothesis>>;
  { estimator.max_distance } -> std::convertible_to<double>;
};

/// Aligns two clouds without a guess and verifies the answer: the poses that most matches speak for are
/// refined by ICP and checked by the clouds themselves; of those accepted the one that brings most matches together
/// wins.
///
/// Defaults are for LiDAR scans, voxels of 0.5 m; `for_submaps` has those for submaps, of 1 m.
template <class Estimator = GraphConsensus<>, class Refinement = CoarseToFine<Icp<PointToPlane, Huber>>,
          class Check = Verifier>
struct VerifiedRegistration {
  static_assert(
      HypothesisEstimator<Estimator>,
      "VerifiedRegistration: Estimator needs `gather(source, target, matches)`, `hypotheses(points, count, executor, "
      "deadline)` and `max_distance`, as in GraphConsensus; see chainslam/registration/graph_consensus.hpp");
  static_assert(Registration<Refinement, PointCloud<float>, IndexedCloud<>>,
                "VerifiedRegistration: Refinement needs `AlignResult align(source, target, guess, executor) const`, as "
                "in Icp; see chainslam/registration/concepts.hpp");
  static_assert(PoseVerifier<Check>,
                "VerifiedRegistration: Check needs `Verification verify(source, target, T_target_source, viewpoints, "
                "executor) const`, as in Verifier; see chainslam/registration/verifier.hpp");

  /// Matching and description.
  FeatureRegistration<Estimator> features{.voxel_size = 0.5,
                                          .normals = {.neighbors = 0, .radius = 1.5},
                                          .features = {.radius = 2.5, .max_neighbors = 0},
                                          .estimator = {.max_distance = 0.75}};
  Index hypotheses = 2;  ///< poses to try, at most
  /// Weak directions are followed, too: the matches know them less than the planes do.
  Refinement refinement{
      .coarse = {.max_iterations = 10, .max_distance = 1.0, .degeneracy_threshold = 0.001, .kernel = {.width = 0.2}},
      .fine = {.max_iterations = 15, .max_distance = 0.5, .degeneracy_threshold = 0.001, .kernel = {.width = 0.1}}};
  Check check{};                           ///< accepts or rejects poses
  std::optional<Viewpoints> viewpoints{};  ///< where both clouds were seen from one place each, as scans are

  /// For submaps of several scans, seen from many places.
  ///
  /// Half submaps sought in whole ones, with 1 m voxels: all 17 poses in a courtyard (real, Livox Avia), all 30 on a
  /// campus and 55 of 57 of a car among traffic (both simulated) were found, with a plane rmse of at most 0.168, 0.164
  /// and 0.197 m and seven of ten normals that agree; 73 wrong ones, all simulated, have 0.247 m and more, but for one
  /// with 0.216 m and 0.36 of its normals.
  /// @param voxel_size  metres.
  [[nodiscard]] static VerifiedRegistration for_submaps(double voxel_size = 1.0) {
    VerifiedRegistration registration;
    registration.features.voxel_size = voxel_size;
    registration.features.normals.radius = 3 * voxel_size;
    registration.features.features.radius = 5 * voxel_size;
    registration.features.estimator.max_distance = 1.5 * voxel_size;
    registration.check.max_plane_rmse = 0.21;
    registration.check.min_aligned_normals = 0.65;
    return registration;
  }

  /// See `FeatureRegistration::describe`.
  template <Cloud Points, Executor Exec = Serial>
  [[nodiscard]] DescribedCloud describe(const Points& points, const Exec& executor = {}) const {
    return features.describe(points, executor);
  }

  /// All poses that were tried, the accepted ones first, those that more matches speak for before others. The second
  /// and later ones are tried only while no pose was accepted that clearly more matches speak for.
  ///
  /// @param deadline  past it, what has been tried so far is the answer; none is returned unrefined or unchecked.
  template <Executor Exec = Serial>
  [[nodiscard]] std::vector<VerifiedPose> candidates(const DescribedCloud& source, const DescribedCloud& target,
                                                     const Exec& executor = {}, const Deadline& deadline = {}) const {
    const std::vector<FeatureMatch> matches =
        match_features(source.features, target.features, features.matching, executor);
    const MatchedPoints points = features.estimator.gather(source.cloud.cloud(), target.cloud, matches);
    std::vector<VerifiedPose> poses;
    if (deadline.passed()) return poses;
    double accepted_gain = 0;
    for (const Hypothesis& hypothesis : features.estimator.hypotheses(points, hypotheses, executor, deadline)) {
      if (clearly * hypothesis.gain < accepted_gain) break;
      poses.push_back(verify(source, target, points, hypothesis, executor, deadline));
      if (poses.back().verification.accepted()) accepted_gain = std::max(accepted_gain, hypothesis.gain);
      if (deadline.passed()) break;
    }
    std::stable_sort(poses.begin(), poses.end(), [](const VerifiedPose& a, const VerifiedPose& b) {
      const auto rank = [](const VerifiedPose& pose) {
        return std::pair(pose.verification.accepted(), pose.result.consensus);
      };
      return rank(a) > rank(b);
    });
    return poses;
  }

  /// @returns T_target_source of the best pose with its figures; status `refused` if the check accepted none, then with
  /// the pose and figures of the best that it refused.
  template <Executor Exec = Serial>
  [[nodiscard]] GlobalAlignResult align(const DescribedCloud& source, const DescribedCloud& target,
                                        const Exec& executor = {}, const Deadline& deadline = {}) const {
    constexpr std::size_t least_points = 3;
    if (source.cloud.size() < least_points || target.cloud.size() < least_points) return {};
    const std::vector<VerifiedPose> tried = candidates(source, target, executor, deadline);
    if (!tried.empty()) return tried.front().result;
    GlobalAlignResult none;
    none.status = deadline.passed() ? GlobalAlignStatus::cancelled : GlobalAlignStatus::no_consensus;
    return none;
  }

  /// The same for clouds as they come; see `FeatureRegistration::describe`.
  template <Cloud Source, Cloud Target, Executor Exec = Serial>
  [[nodiscard]] GlobalAlignResult align(const Source& source, const Target& target, const Exec& executor = {},
                                        const Deadline& deadline = {}) const {
    const auto described = features.describe_both(source, target, executor);
    return align(described.first, described.second, executor, deadline);
  }

 private:
  static constexpr double clearly = 2;

  template <class Exec>
  [[nodiscard]] VerifiedPose verify(const DescribedCloud& source, const DescribedCloud& target,
                                    const MatchedPoints& points, const Hypothesis& hypothesis, const Exec& executor,
                                    const Deadline& deadline) const {
    const PointCloud<float>& cloud = source.cloud.cloud();
    const AlignResult refined = refine(cloud, target.cloud, hypothesis.T_target_source, executor, deadline);
    const bool moved_well = refined.status == AlignStatus::converged || refined.status == AlignStatus::degenerate ||
                            refined.status == AlignStatus::iteration_limit;
    const SE3d& T = moved_well ? refined.T_target_source : hypothesis.T_target_source;
    VerifiedPose pose;
    pose.verification = check.verify(cloud, target.cloud, T, viewpoints, executor);
    const Hypothesis judged = detail::judge(points, T, features.estimator.max_distance);
    const chainslam::Overlap& overlap = pose.verification.overlap;
    pose.result.T_target_source = T;
    pose.result.fitness_target = overlap.share_of_target;
    pose.result.fitness_source = overlap.share_of_source;
    pose.result.inlier_rmse = overlap.rmse;
    pose.result.inliers = overlap.inliers;
    pose.result.matches = points.size();
    pose.result.consensus = judged.consensus;
    pose.result.putative_ratio = points.size() > 0 ? static_cast<double>(judged.consensus) / points.size() : 0.0;
    pose.result.status = pose.verification.accepted() ? GlobalAlignStatus::found : GlobalAlignStatus::refused;
    pose.result.verified = true;
    return pose;
  }

  template <class Exec>
  [[nodiscard]] AlignResult refine(const PointCloud<float>& source, const IndexedCloud<>& target, const SE3d& guess,
                                   const Exec& executor, const Deadline& deadline) const {
    if constexpr (requires { refinement.align(source, target, guess, executor, deadline); })
      return refinement.align(source, target, guess, executor, deadline);
    else
      return refinement.align(source, target, guess, executor);
  }
};
static_assert(GlobalRegistration<VerifiedRegistration<>, PointCloud<float>, PointCloud<float>>);

}  // namespace chainslam
