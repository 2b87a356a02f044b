#pragma once

#include <Eigen/Core>
#include <concepts>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/search/concepts.hpp"

namespace chainslam {

/// A cloud whose traits know a covariance (3x3, m^2 or regularized) at every point.
template <class T>
concept DistributedCloud = Cloud<T> && requires(const T& cloud, std::size_t i) {
  { CloudTraits<T>::covariance(cloud, i)(0, 0) } -> std::convertible_to<double>;
};

/// How an alignment ended.
enum class AlignStatus {
  converged,        ///< the last step was smaller than the thresholds
  iteration_limit,  ///< still moving after the last iteration
  too_few_points,   ///< source or target has too few finite points; the pose is the guess
  no_overlap,       ///< too few source points have a partner; the pose is the guess
  degenerate,       ///< converged in the observable directions; unobservable ones kept from the initial guess
  cancelled,        ///< the deadline passed first; the pose is the best so far
};

/// What ended the iterations.
enum class StopReason {
  not_started,        ///< nothing to iterate on, or no iterations asked for
  small_step,         ///< the step was below both tolerances
  small_improvement,  ///< the cost fell by less than its tolerance
  no_improvement,     ///< no step lowers the cost: a minimum to rounding
  lost_overlap,       ///< too few partners were left
  iteration_limit,
  deadline,
};

/// What an alignment found. The figures hold at the pose returned.
///
/// Tangents are [translation; rotation] of a right perturbation of T_target_source. Spectrum and localizability are
/// about the source's centroid, rotations measured in metres at the inliers' root mean square distance from it, so that
/// all six are of one kind.
struct AlignResult {
  SE3d T_target_source;  ///< maps source points into the target's frame
  /// Sum of w J'J: the information if the residuals had a standard deviation of 1 m. Semi-definite: directions found
  /// degenerate carry none.
  Matrix6d hessian = zeros<Matrix6d>();
  /// Of T_target_source, for residuals that err independently of one another: the residuals' variance times hessian^-1.
  /// Never beyond the largest distance between partners, which is what directions found degenerate have.
  Matrix6d covariance = zeros<Matrix6d>();
  Vector6d eigenvalues = zeros<Vector6d>();      ///< of the hessian per inlier: mean squared cosines, ascending
  Matrix6d eigenvectors = identity<Matrix6d>();  ///< columns: the directions that go with them
  Index degenerate_directions = 0;               ///< how many of them, the first, were held at the guess
  /// For each axis, what is known of it when nothing is known of the others, per inlier: 1 over the diagonal of the
  /// inverse. A tenth of the degeneracy threshold, which is the least: unobservable, as along a corridor.
  Vector6d localizability = zeros<Vector6d>();
  Index inliers = 0;                 ///< source points whose nearest target point is near enough, and not rejected
  double inlier_ratio = 0;           ///< inliers over finite source points
  double overlap = 0;                ///< the same, rejected ones included
  double mean_squared_error = 0;     ///< of the distance to the nearest point over inliers, m^2: the paper's e_ij
  double mean_squared_residual = 0;  ///< of what the metric measures over inliers, m^2
  AlignStatus status = AlignStatus::too_few_points;  ///< how it ended
  StopReason stop = StopReason::not_started;         ///< what ended the iterations
  Index iterations = 0;                              ///< steps taken

  /// Whether it converged in all directions.
  [[nodiscard]] bool converged() const { return status == AlignStatus::converged; }
};

/// How an alignment without a guess ended.
enum class GlobalAlignStatus {
  found,            ///< a pose that many matches agree on; the figures say how far to trust it
  too_few_points,   ///< source or target has too few points with a feature; the pose is the identity
  too_few_matches,  ///< fewer than three points look alike; the pose is the identity
  no_consensus,     ///< no pose that matches agree on beyond chance; the pose is the identity
  refused,          ///< rejected by verification; the pose is the rejected one
  cancelled,        ///< the deadline passed before there was a pose; it is the identity
};

/// What an alignment without a guess found. The figures hold at the pose returned; the fits are zero without one.
struct GlobalAlignResult {
  SE3d T_target_source;       ///< maps source points into the target's frame
  double fitness_target = 0;  ///< inliers over target points: the paper's f^R, small where the target is the larger one
  double fitness_source = 0;  ///< inliers over source points: the share of the source that overlaps
  double inlier_rmse = 0;     ///< of the inliers' distances to their nearest target points, metres
  Index inliers = 0;          ///< source points whose nearest target point is near enough, the paper's |C_inlier|
  Index matches = 0;          ///< putative matches: pairs of points that look alike
  Index consensus = 0;        ///< matches that the pose brings together
  double putative_ratio = 0;  ///< consensus over matches: what the paper's released program compares with its threshold
  GlobalAlignStatus status = GlobalAlignStatus::too_few_points;  ///< how it ended
  Index iterations = 0;                                          ///< hypotheses tried
  bool verified = false;  ///< whether the clouds themselves were asked about the pose, and not the matches alone

  /// Whether a pose was found and, where it was checked, accepted.
  [[nodiscard]] bool found() const { return status == GlobalAlignStatus::found; }
};

/// What a metric says of one pair: the error e and its derivative by the moved point, de / dp, in the target's frame.
template <int Rows>
struct PairError {
  static constexpr int rows = Rows;         ///< rows of the residual
  Eigen::Matrix<double, Rows, 1> residual;  ///< metres
  Eigen::Matrix<double, Rows, 3> gradient;  ///< de / dp
};

/// A target that says itself which of its elements a point goes with, as a voxel map's cells do.
///
/// Law: `match(query, max_distance)` gives an index whose `position` lies within `max_distance`, or -1, and depends on
/// the arguments alone.
template <class T>
concept MatchingTarget = requires(const T& target, const Eigen::Matrix<typename T::Scalar, 3, 1>& query,
                                  typename T::Scalar distance, Index i) {
  { target.match(query, distance) } -> std::same_as<Index>;
  { target.position(i)[0] } -> std::convertible_to<typename T::Scalar>;
  { target.size() } -> std::convertible_to<std::size_t>;
};

/// What a source can be aligned to: the nearest point is its match, or the one that the target names.
template <class T>
concept AlignTarget = NearestNeighborSearch<T> || MatchingTarget<T>;

/// Measures how badly a moved source point and its match in the target fit, pair by pair. Metrics of surfaces, which
/// are worked on four pairs at a time, are `SurfaceMetric`s.
///
/// `metric.error(target, match, p_target)` gives a `PairError` whose gradient is exact where the match stays the same.
/// A match without information (no normal) gives zeros.
template <class Metric, class Target>
concept ErrorMetric = AlignTarget<Target> &&
    requires(const Metric& metric, const Target& target, Index match, const Eigen::Vector3d& p_target) {
  { metric.error(target, match, p_target).residual } -> std::convertible_to<Eigen::VectorXd>;
  { metric.error(target, match, p_target).gradient } -> std::convertible_to<Eigen::MatrixXd>;
};

/// Finds T_target_source, which maps source points into the target's frame, from a guess.
///
/// The result depends on the arguments alone, not on the executor. Not converging is a status, never a throw.
template <class R, class Source, class Target>
concept Registration = Cloud<Source> && AlignTarget<Target> &&
    requires(const R& registration, const Source& source, const Target& target, const SE3d& guess,
             const Serial& executor) {
  { registration.align(source, target, guess, executor) } -> std::same_as<AlignResult>;
};

/// Finds T_target_source, which maps source points into the target's frame, of two clouds without a guess.
///
/// The result depends on the arguments alone, not on the executor. Finding nothing is a status, never a throw.
template <class R, class Source, class Target>
concept GlobalRegistration = Cloud<Source> && Cloud<Target> &&
    requires(const R& registration, const Source& source, const Target& target, const Serial& executor) {
  { registration.align(source, target, executor) } -> std::same_as<GlobalAlignResult>;
};

}  // namespace chainslam
