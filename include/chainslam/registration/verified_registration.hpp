#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <concepts>
#include <cstddef>
#include <limits>
#include <optional>
#include <span>
#include <stdexcept>
#include <utility>
#include <vector>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/registration/align.hpp"
#include "chainslam/registration/alignment_checks.hpp"
#include "chainslam/registration/concepts.hpp"
#include "chainslam/registration/feature_registration.hpp"
#include "chainslam/registration/graph_consensus.hpp"
#include "chainslam/registration/icp.hpp"
#include "chainslam/search/concepts.hpp"
#include "chainslam/search/indexed_cloud.hpp"

namespace chainslam {

/// Why a pose was refused.
enum class Refusal {
  none,            ///< it was not
  low_overlap,     ///< too little of the smaller cloud lies on the other
  high_residual,   ///< what lies together does not fit: points beside the other's planes
  turned_normals,  ///< surfaces that lie together face elsewhere
  seen_through,    ///< one cloud's points stand where the other's sensor saw through
};

/// The refusal in words.
[[nodiscard]] constexpr const char* to_string(Refusal refusal) {
  switch (refusal) {
    case Refusal::none:
      return "accepted";
    case Refusal::low_overlap:
      return "too little overlap";
    case Refusal::high_residual:
      return "what overlaps does not fit";
    case Refusal::turned_normals:
      return "surfaces that overlap face elsewhere";
    case Refusal::seen_through:
      return "points where the other sensor saw through";
  }
  return "unknown";
}

/// What speaks for a pose and against it.
struct Verification {
  Overlap overlap;                  ///< of the source on the target
  double share_of_smaller = 0;      ///< inliers over the points of the smaller cloud
  double plane_rmse = 0;            ///< of the inliers' distances to the planes of their nearest target points, metres
  double aligned_normals = 1;       ///< share of the inliers with normals whose normals agree to 45 degrees
  double seen_through = 0;          ///< share of the points in the other's view that stand in front of what it saw
  Index in_view = 0;                ///< points, of both clouds, in the other's view
  Refusal refusal = Refusal::none;  ///< why it was rejected; none if it was accepted

  [[nodiscard]] bool accepted() const { return refusal == Refusal::none; }  ///< whether the pose was accepted
};

/// Where the sensors stood, each in its own cloud's frame, metres; what is free space follows.
struct Viewpoints {
  Eigen::Vector3d source = Eigen::Vector3d::Zero();  ///< in the source's frame, metres
  Eigen::Vector3d target = Eigen::Vector3d::Zero();  ///< in the target's frame, metres
};

/// Checks a pose by the clouds themselves: overlap, residual, normals, and free space (Bosse and Zlot 2008): no point
/// may stand where the other sensor looked through.
///
/// Its figures count points; clouds are best downsampled to even density first.
struct Verifier {
  double max_distance = 0.75;         ///< metres, of an inlier
  double min_overlap = 0.08;          ///< of the smaller cloud
  double max_plane_rmse = 0.18;       ///< metres: right poses of scans at 0.5 m had 0.07 to 0.14, wrong ones 0.21
  double min_aligned_normals = 0.75;  ///< right: 0.81 and more
  double max_seen_through = 0.02;     ///< right: at most 0.007; wrong: from 0.03
  double view_cell = 0.035;           ///< radians, about what a downsampled cloud leaves no gaps in
  double view_margin = 1.0;           ///< metres in front of what was seen, and
  double view_margin_ratio = 0.05;    ///< metres for each metre of range

  /// @param source, target  with normals where they have them.
  /// @param viewpoints      where both clouds were seen from one place each; nothing: free space is not looked at.
  /// @returns figures and the first reason to refuse; the same to the bit for any executor.
  /// @throws std::invalid_argument if an option or the pose makes no sense.
  template <Executor Exec = Serial>
  [[nodiscard]] Verification verify(const PointCloud<float>& source, const IndexedCloud<>& target,
                                    const SE3d& T_target_source, const std::optional<Viewpoints>& viewpoints = {},
                                    const Exec& executor = {}) const {
    if (!(view_cell > 0) || !(view_margin >= 0))
      throw std::invalid_argument("Verifier: view_cell must be positive, view_margin not negative");
    Verification result;
    result.overlap = measure_overlap(source, target, T_target_source, max_distance, executor);
    const std::size_t smaller = std::min(source.size(), target.size());
    if (smaller > 0) result.share_of_smaller = std::min(1.0, result.overlap.inliers / static_cast<double>(smaller));
    measure_surfaces(source, target, T_target_source, result, executor);
    if (viewpoints) measure_views(source, target.cloud(), T_target_source, *viewpoints, result, executor);
    result.refusal = judge(result);
    return result;
  }

 private:
  [[nodiscard]] Refusal judge(const Verification& figures) const {
    if (!(figures.share_of_smaller >= min_overlap)) return Refusal::low_overlap;
    if (!(figures.plane_rmse <= max_plane_rmse)) return Refusal::high_residual;
    if (!(figures.aligned_normals >= min_aligned_normals)) return Refusal::turned_normals;
    if (!(figures.seen_through <= max_seen_through)) return Refusal::seen_through;
    return Refusal::none;
  }

  template <class Exec>
  void measure_surfaces(const PointCloud<float>& source, const IndexedCloud<>& target, const SE3d& T,
                        Verification& result, const Exec& executor) const {
    constexpr Index grain = 512;
    constexpr float least_cosine = 0.7071F;
    struct Sums {
      Index planes = 0, normals = 0, aligned = 0;
      double squared = 0;
    };
    if (!target.has_normals()) return;
    const Eigen::Matrix3f R = T.rotation().matrix().cast<float>();
    const Eigen::Vector3d t = T.translation();
    const Eigen::Matrix3d R_exact = T.rotation().matrix();
    const auto sum_chunk = [&](Index begin, Index end) {
      Sums sums;
      for (auto i = static_cast<std::size_t>(begin); i < static_cast<std::size_t>(end); ++i) {
        const Eigen::Vector3f p = (R_exact * source.positions[i].cast<double>() + t).cast<float>();
        Neighbor<float> nearest;
        if (!is_finite(p) || target.knn(p, std::span(&nearest, 1), static_cast<float>(max_distance)) == 0) continue;
        const Eigen::Vector3f& n = target.normal(nearest.index);
        if (!(n.squaredNorm() > 0.25F)) continue;
        const auto distance = static_cast<double>(n.dot(p - target.position(nearest.index)));
        sums.squared += distance * distance;
        ++sums.planes;
        if (!source.has_normals() || !(source.normals[i].squaredNorm() > 0.25F)) continue;
        ++sums.normals;
        sums.aligned += n.dot(R * source.normals[i]) > least_cosine ? 1 : 0;
      }
      return sums;
    };
    const Sums all = reduce_chunks(
        executor, to_index(source.size(), "cloud"), grain, Sums{}, sum_chunk, [](const Sums& a, const Sums& b) {
          return Sums{a.planes + b.planes, a.normals + b.normals, a.aligned + b.aligned, a.squared + b.squared};
        });
    if (all.planes > 0) result.plane_rmse = std::sqrt(all.squared / all.planes);
    if (all.normals > 0) result.aligned_normals = static_cast<double>(all.aligned) / all.normals;
  }

  template <class Exec>
  void measure_views(const PointCloud<float>& source, const PointCloud<float>& target, const SE3d& T,
                     const Viewpoints& viewpoints, Verification& result, const Exec& executor) const {
    const FreeSpaceOptions view{.cell = view_cell,
                                .margin = view_margin,
                                .margin_ratio = view_margin_ratio,
                                .max_range = std::numeric_limits<double>::infinity(),
                                .max_points = std::numeric_limits<Index>::max()};
    FreeSpaceCount of_source, of_target;
    call_both(
        executor, [&] { of_source = FreeSpace(target, viewpoints.target, view).count(source, T); },
        [&] { of_target = FreeSpace(source, viewpoints.source, view).count(target, T.inverse()); });
    of_source += of_target;
    result.in_view = of_source.in_view;
    result.seen_through = of_source.share();
  }
};

/// Checks a pose: `verify(source, target, T_target_source, viewpoints, executor)`, as `Verifier` does.
template <class V>
concept PoseVerifier = requires(const V& verifier, const PointCloud<float>& source, const IndexedCloud<>& target,
                                const SE3d& T, const std::optional<Viewpoints>& viewpoints, const Serial& executor) {
  { verifier.verify(source, target, T, viewpoints, executor) } -> std::same_as<Verification>;
};
static_assert(PoseVerifier<Verifier>);

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
                "executor) const`, as in Verifier; see chainslam/registration/verified_registration.hpp");

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
