#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <concepts>
#include <cstddef>
#include <limits>
#include <memory>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/noise_model.hpp"
#include "chainslam/registration/align.hpp"
#include "chainslam/registration/alignment_checks.hpp"
#include "chainslam/registration/concepts.hpp"
#include "chainslam/slam/closure_candidates.hpp"
#include "chainslam/slam/slam_map.hpp"
#include "chainslam/slam/submap.hpp"

namespace chainslam {

/// Says how far an accepted alignment may be off: the covariance of T_target_source, tangent [translation; rotation].
template <class C>
concept ClosureCovariance = requires(const C& covariance, const AlignResult& result) {
  { covariance(result) } -> std::convertible_to<Matrix6d>;
};

namespace detail {

/// Adds the squares of one number for the translation and one for the rotation to the diagonal.
inline void add_squares(Matrix6d& sum, double translation, double rotation) {
  for (int i = 0; i < 3; ++i) {
    sum(i, i) += translation * translation;
    sum(i + 3, i + 3) += rotation * rotation;
  }
}

}  // namespace detail

/// The paper's: lambda e_ij I_6, the same number for m^2 and rad^2.
struct IsotropicCovariance {
  double lambda = 1e-4;  ///< variance, m^2 and rad^2, over the mean squared error
  double least = 1e-9;   ///< m^2 and rad^2: a perfect fit is still no certainty

  /// How many residuals err as one.
  [[nodiscard]] Matrix6d operator()(const AlignResult& result) const { return (*this)(result.mean_squared_error); }
  /// @param mean_squared_error  m^2
  [[nodiscard]] Matrix6d operator()(double mean_squared_error) const {
    const double variance = std::max(lambda * mean_squared_error, least);
    Matrix6d covariance = zeros<Matrix6d>();
    for (int i = 0; i < 6; ++i) covariance(i, i) = variance;
    return covariance;
  }
};
static_assert(ClosureCovariance<IsotropicCovariance>);

/// From the registration's Hessian: directions that the points do not determine stay open.
///
/// Sigma = (H / (c s^2) + P)^-1 + F, with s^2 the mean squared residual, c the number of neighbouring residuals that
/// err together, P what is known beforehand (the pose is not off by more than the search radius) and F a floor for what
/// the residuals do not show: voxels, and the submap's own bend.
struct HessianCovariance {
  double correlated_residuals = 100;  ///< 6 x 6, of T_target_source, tangent [translation; rotation]
  double prior_translation = 5.0;     ///< metres
  double prior_rotation = 0.2;        ///< radians
  double floor_translation = 0.05;    ///< metres
  double floor_rotation = 0.002;      ///< radians

  /// 6 x 6, of T_target_source, tangent [translation; rotation].
  [[nodiscard]] [[gnu::cold]] Matrix6d operator()(const AlignResult& result) const {
    constexpr double least_residual = 1e-4;  // m^2: a centimetre, the sensor's own noise
    const double variance = correlated_residuals * std::max(result.mean_squared_residual, least_residual);
    Matrix6d information = result.hessian;
    for (int i = 0; i < 36; ++i) information.data()[i] /= variance;
    detail::add_squares(information, 1 / prior_translation, 1 / prior_rotation);
    const Matrix6d root = solved_right(identity<Matrix6d>(), cholesky(information));
    Matrix6d covariance = symmetric(times_transposed(root, root));
    detail::add_squares(covariance, floor_translation, floor_rotation);
    return covariance;
  }
};
static_assert(ClosureCovariance<HessianCovariance>);

/// When an alignment counts as a closure.
struct ClosureGate {
  double max_misfit = 1.5;    ///< see `SurfaceFit::worst_misfit`, by the share that counts; 0: not looked at
  double misfit_share = 0.8;  ///< of the scan: the rest may be traffic, see `SurfaceFitOptions::share`
  /// Of the same over the root of the least localizability relative to 0.2: what exceeds it counts if it is repeatable.
  /// Where a pose is wrong along a street, only the few residuals that determine it there show it.
  double sure_misfit = 1.6;
  double repeat_below = 0.04;         ///< least localizability below which an alignment has to be repeatable; 0: none
  double repeat_shift = 1.0;          ///< metres, see `is_repeatable`
  double repeat_distance = 0.5;       ///< metres, see `is_repeatable`
  double max_mean_squared_error = 0;  ///< m^2 over inliers (tau of the paper, section 5: 0.3 at 2 m); 0: any
  double min_inlier_ratio = 0.6;      ///< of the scan's points with a partner in the submap
  double max_translation = 10.0;      ///< metres that the graph may have been off
  double max_rotation = 0.5;          ///< radians that the graph may have been off
  bool accept_iteration_limit =
      false;  ///< whether an alignment that was still moving after its last step will do (PCL)

  /// How badly a scan lies on a submap by the share that counts.
  /// @param noise   of the submap, by `surface_noise`, metres.
  template <Cloud Scan, OrientedSearch Target>
  [[nodiscard]] double misfit(const Scan& scan, const Target& submap, double noise, const SE3d& T_submap_scan) const {
    return surface_fit(scan, submap, T_submap_scan, {.share = misfit_share}).worst_misfit(noise);
  }

  /// Whether an alignment with this misfit counts without being repeated.
  [[nodiscard]] [[gnu::cold]] bool is_sure(const AlignResult& result, double misfit) const {
    constexpr double least = 0.03, enough = 0.2;
    const double localizability = weakest_direction(result).localizability;
    return localizability >= repeat_below &&
           misfit <= sure_misfit * std::sqrt(std::clamp(localizability, least, enough) / enough);
  }

  /// What the registration says of itself, all but the misfit, which the clouds say. Bounds are met or not: a figure
  /// that is not a number meets none.
  [[nodiscard]] [[gnu::cold]] ClosureVerdict judge(const AlignResult& result, const SE3d& guess) const {
    const bool ended = result.status == AlignStatus::converged || result.status == AlignStatus::degenerate ||
                       (accept_iteration_limit && result.status == AlignStatus::iteration_limit);
    if (!ended)
      return result.status == AlignStatus::iteration_limit ? ClosureVerdict::not_converged
                                                           : ClosureVerdict::too_few_inliers;
    if (!(result.inlier_ratio >= min_inlier_ratio)) return ClosureVerdict::too_few_inliers;
    if (max_mean_squared_error > 0 && !(result.mean_squared_error <= max_mean_squared_error))
      return ClosureVerdict::high_residual;
    const SE3d correction = guess.inverse() * result.T_target_source;
    if (!(correction.translation().norm() <= max_translation && correction.rotation().log().norm() <= max_rotation))
      return ClosureVerdict::implausible;
    return ClosureVerdict::accepted;
  }
};

/// When closures are sought, and when accepted.
struct LoopCloserOptions {
  double min_travel = 4.0;   ///< metres along the path between two searches (v / f_lc of the paper); 0: every keyframe
  double min_period = 0;     ///< seconds of the data between two searches (1 / f_lc); 0: by the way alone
  double scan_voxel = 0;     ///< metres, of the scan that is aligned; 0: as the keyframe has it
  AlignmentStarts starts{};  ///< where a refused alignment starts again
  ClosureGate gate{};        ///< when an alignment counts as a closure
  /// Misfit up to which a closure errs by what its covariance says; beyond it, by as many times more. 0: by what the
  /// covariance says, whatever the misfit.
  double usual_misfit = 0.5;
  SubmapOptions submap{};  ///< what the scan is aligned to
};

/// Closes loops: aligns the newest keyframe's scan to the submaps of keyframes that may have seen the same place.
///
/// @tparam Candidates   which keyframes to try.
/// @tparam Registration aligns scan i to submap j and so gives T_j_i = x_j^-1 x_i, the measurement from j to i; with an
/// executor of several threads, it is called by several at a time.
/// @tparam Covariance   how far an accepted alignment may be off.
template <class Candidates = ProximityCandidates, class Registration = CoarseToFine<>,
          class Covariance = HessianCovariance>
class LoopCloser {
  static_assert(ClosureCandidates<Candidates>,
                "LoopCloser: Candidates needs `std::vector<KeyframeId> find(keyframes, index, query)` and `bool "
                "eligible(candidate, query) const`, as in ProximityCandidates");
  static_assert(chainslam::Registration<Registration, PointCloud<float>, Submap>,
                "LoopCloser: Registration needs `AlignResult align(source, target, guess, executor) const`, as in Icp");
  static_assert(ClosureCovariance<Covariance>,
                "LoopCloser: Covariance needs `Matrix6d operator()(const AlignResult&) const`, as in "
                "HessianCovariance");

 public:
  /// Starts without submaps. Policies are moved in, with their settings.
  [[gnu::cold]] explicit LoopCloser(const LoopCloserOptions& options = {}, Candidates candidates = Candidates{},
                                    Registration registration = Registration{}, Covariance covariance = Covariance{})
      : options_(options),
        candidates_(std::move(candidates)),
        registration_(std::move(registration)),
        covariance_(std::move(covariance)),
        submaps_(options.submap) {}

  /// Tries the newest keyframe, the last of `keyframes`, if it lies far enough along the path from the last one tried.
  /// @see search
  template <Executor E = Serial>
  [[nodiscard]] [[gnu::cold]] std::vector<LoopClosure> close(std::span<const Keyframe> keyframes,
                                                             const PositionIndex& index, const E& executor = {});

  /// Tries candidates for `query` in their order until one is accepted; if none is, the first again from elsewhere: see
  /// `AlignmentStarts`. That needs a registration with `rough`, as `CoarseToFine` has it.
  ///
  /// @param index  positions of the keyframes in the query's frame.
  /// @returns what was tried, refusals and at most one accepted closure, each with its verdict.
  template <Executor E = Serial>
  [[nodiscard]] [[gnu::cold]] std::vector<LoopClosure> search(std::span<const Keyframe> keyframes,
                                                              const PositionIndex& index, KeyframeId query,
                                                              const E& executor = {});

  /// Whether two keyframes may be closed at all.
  [[nodiscard]] bool eligible(const Keyframe& candidate, const Keyframe& query) const {
    return candidates_.eligible(candidate, query);
  }

  /// Aligns keyframe `to`'s scan to the submap around `from` and judges the result.
  /// @param guess  T_from_to to start from, from which the gate measures the correction.
  template <Executor E = Serial>
  [[nodiscard]] [[gnu::cold]] LoopClosure align(std::span<const Keyframe> keyframes, KeyframeId from, KeyframeId to,
                                                const SE3d& guess, const E& executor = {}) {
    const AlignmentGuess one{from, guess};
    return align(keyframes, std::span(&one, 1), to, false, executor).front();
  }
  /// The same, faster, for a guess that is off by decimetres at most: by the registration's `refine`, if it has one.
  template <Executor E = Serial>
  [[nodiscard]] [[gnu::cold]] LoopClosure refine(std::span<const Keyframe> keyframes, KeyframeId from, KeyframeId to,
                                                 const SE3d& guess, const E& executor = {}) {
    const AlignmentGuess one{from, guess};
    return align(keyframes, std::span(&one, 1), to, true, executor).front();
  }
  /// The same with the submaps around several keyframes, at the same time where the executor has threads for it.
  template <Executor E = Serial>
  [[nodiscard]] [[gnu::cold]] std::vector<LoopClosure> align(std::span<const Keyframe> keyframes,
                                                             std::span<const AlignmentGuess> guesses, KeyframeId to,
                                                             const E& executor = {}) {
    return align(keyframes, guesses, to, false, executor);
  }
  /// The same for guesses that are off by decimetres at most.
  template <Executor E = Serial>
  [[nodiscard]] [[gnu::cold]] std::vector<LoopClosure> refine(std::span<const Keyframe> keyframes,
                                                              std::span<const AlignmentGuess> guesses, KeyframeId to,
                                                              const E& executor = {}) {
    return align(keyframes, guesses, to, true, executor);
  }

  /// Whether a registered scan lies on its submap but for a share that the other does not have, such as traffic.
  [[nodiscard]] [[gnu::cold]] bool fits_in_part(std::span<const Keyframe> keyframes, const LoopClosure& closure) {
    const PlacedSubmap at = submaps_.get(keyframes, closure.from);
    return options_.gate.misfit(scan_of(keyframes[static_cast<std::size_t>(closure.to.value)]), *at.submap,
                                submaps_.surface_noise(*at.submap),
                                at.T_keyframe_submap.inverse() * closure.T_from_to) <= options_.gate.max_misfit;
  }

  [[nodiscard]] const LoopCloserOptions& options() const { return options_; }  ///< its settings
  [[nodiscard]] const SubmapCache& submaps() const { return submaps_; }        ///< the submaps that it has built
  void free_submaps() { submaps_ = SubmapCache(submaps_.options()); }          ///< until they are asked for again
  /// Metres along the path from one search to the next, of all that `close` made in one session.
  [[nodiscard]] const std::vector<double>& search_spacing() const { return spacing_; }

 private:
  template <Executor E>
  [[nodiscard]] [[gnu::cold]] std::vector<LoopClosure> align(std::span<const Keyframe> keyframes,
                                                             std::span<const AlignmentGuess> guesses, KeyframeId to,
                                                             bool is_good, const E& executor);
  /// Aligns to one submap. @param noise  of its surfaces; measured where it is needed and not known.
  template <Executor E>
  [[gnu::cold]] void align(LoopClosure& closure, const PointCloud<float>& scan, const PlacedSubmap& at,
                           std::optional<double>& noise, bool is_good, const E& executor) const;
  template <Executor E>
  [[nodiscard]] AlignResult registered(const PointCloud<float>& scan, const Submap& submap, const SE3d& guess,
                                       bool is_good, const E& executor) const {
    if constexpr (requires { registration_.refine(scan, submap, guess, executor); })
      if (is_good) return registration_.refine(scan, submap, guess, executor);
    return registration_.align(scan, submap, guess, executor);
  }

  /// Tries the first candidate once more, from the best of other places where the scan may be.
  template <Executor E>
  [[gnu::cold]] void search_wider(std::span<const Keyframe> keyframes, const PositionIndex& index,
                                  std::vector<LoopClosure>& tried, const E& executor);

  /// Whether the newest keyframe lies far enough along the path from the last one that was tried, and late enough.
  [[nodiscard]] bool due(std::span<const Keyframe> keyframes);

  /// The keyframe's scan as it is aligned; kept, since a chain asks for the same one many times.
  [[nodiscard]] const PointCloud<float>& scan_of(const Keyframe& keyframe) {
    if (scan_ && scan_of_ == keyframe.cloud) return *scan_;
    scan_ = keyframe.cloud.load();
    if (options_.scan_voxel > 0)
      scan_ = std::make_shared<const PointCloud<float>>(voxel_downsample(*scan_, options_.scan_voxel));
    scan_of_ = keyframe.cloud;
    return *scan_;
  }

  /// Judges whether an alignment with this misfit lies on its submap, and only there.
  template <Executor E>
  [[nodiscard]] [[gnu::cold]] ClosureVerdict judge_fit(const PointCloud<float>& scan, const Submap& submap,
                                                       const AlignResult& result, double misfit,
                                                       const E& executor) const {
    const ClosureGate& gate = options_.gate;
    if (!(misfit <= gate.max_misfit)) return ClosureVerdict::high_residual;
    const bool counts =
        gate.is_sure(result, misfit) ||
        is_repeatable(registration_, scan, submap, result, gate.repeat_shift, gate.repeat_distance, executor);
    return counts ? ClosureVerdict::accepted : ClosureVerdict::not_converged;
  }

  /// Standard deviations of a closure with this misfit over what its covariance says.
  [[nodiscard]] double inflation(double misfit) const {
    return options_.usual_misfit > 0 ? std::max(1.0, misfit / options_.usual_misfit) : 1.0;
  }

  LoopCloserOptions options_;
  [[no_unique_address]] Candidates candidates_;
  [[no_unique_address]] Registration registration_;
  [[no_unique_address]] Covariance covariance_;
  SubmapCache submaps_;
  std::shared_ptr<const PointCloud<float>> scan_;  ///< the last one aligned
  KeyframeScan scan_of_;                           ///< and of which it was made
  // Metres since the last search: the first is due at once.
  double travelled_ = std::numeric_limits<double>::infinity();
  std::optional<std::pair<SessionId, Timestamp>> searched_;  ///< the last time
  std::vector<double> spacing_;
  Index refused_ = 0;  ///< searches in a row without an accepted closure
};

template <class Candidates, class Registration, class Covariance>
template <Executor E>
std::vector<LoopClosure> LoopCloser<Candidates, Registration, Covariance>::close(std::span<const Keyframe> keyframes,
                                                                                 const PositionIndex& index,
                                                                                 const E& executor) {
  if (keyframes.empty() || !due(keyframes)) return {};
  return search(keyframes, index, keyframes.back().id, executor);
}

template <class Candidates, class Registration, class Covariance>
bool LoopCloser<Candidates, Registration, Covariance>::due(std::span<const Keyframe> keyframes) {
  const Keyframe& newest = keyframes.back();
  if (keyframes.size() > 1 && keyframes[keyframes.size() - 2].session == newest.session) {
    const Keyframe& before = keyframes[keyframes.size() - 2];
    travelled_ += (before.T_odom_body.inverse() * newest.T_odom_body).translation().norm();
  }
  const bool same_session = searched_ && searched_->first == newest.session;
  if (travelled_ < options_.min_travel) return false;
  if (same_session && to_seconds(newest.time - searched_->second) < options_.min_period) return false;
  if (same_session) spacing_.push_back(travelled_);
  searched_ = {newest.session, newest.time};
  travelled_ = 0;
  return true;
}

}  // namespace chainslam

// Bodies of its members.
#include "chainslam/slam/detail/loop_closer_alignments.hpp"
