#pragma once

#include <Eigen/Core>
#include <cmath>
#include <concepts>
#include <optional>
#include <stdexcept>
#include <utility>

#include "chainslam/core/compiled.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/registration/concepts.hpp"
#include "chainslam/registration/detail/icp_run.hpp"
#include "chainslam/registration/detail/source_columns.hpp"
#include "chainslam/registration/metrics.hpp"
#include "chainslam/registration/optimizers.hpp"
#include "chainslam/registration/rejectors.hpp"
#include "chainslam/search/indexed_cloud.hpp"

namespace chainslam {

namespace detail {
/// Makes what `Icp` works on of a plain cloud; defined in registration/align.hpp, which brings the estimation of
/// normals.
template <class T>
struct PlainCloud;
}  // namespace detail

/// Iterative closest points (Besl and McKay 1992; Chen and Medioni 1992): iterates association of every source point
/// with its nearest target point, linearization and an update on SE(3).
///
/// Steps are motions of the source's centroid and about it, so that neither the frame's origin nor the point count
/// changes what the thresholds mean. Directions that the points do not determine are left at the guess and reported.
/// Nearest-neighbour queries whose result provably cannot change are skipped.
///
/// @tparam Metric     what a pair measures: `PointToPlane`, `PointToPoint`, `PlaneToPlane` (GICP),
///                    `DistributionToDistribution` (GICP with covariances, VGICP), or your own.
/// @tparam Kernel     weighs pairs by their residual.
/// @tparam Rejector   drops pairs, see `rejectors.hpp`.
/// @tparam Optimizer  chooses steps.
/// @tparam Prior      prior knowledge of the pose.
template <class Metric = PointToPlane, class Kernel = Trivial, class Rejector = KeepPairs,
          class Optimizer = GaussNewtonStep, class Prior = NoPrior>
struct Icp {
  static_assert(RobustKernel<Kernel>,
                "Icp: Kernel needs `double weight(double squared_residual) const`, as in Huber; see "
                "chainslam/core/robust_kernels.hpp");
  static_assert(MatchRejector<Rejector>,
                "Icp: Rejector needs `static constexpr bool needs_normals` and `void operator()(pairs) const`, as in "
                "OneToOne; see chainslam/registration/rejectors.hpp");
  static_assert(PoseOptimizer<Optimizer>,
                "Icp: Optimizer needs `initial_damping` and `std::optional<Vector6d> step(problem, damping) const`, as "
                "in GaussNewtonStep; see chainslam/registration/optimizers.hpp");
  static_assert(AlignPrior<Prior>,
                "Icp: Prior needs `PriorTerms evaluate(T_target_source) const`, as in PosePrior; see "
                "chainslam/registration/optimizers.hpp");
  static_assert(std::same_as<Optimizer, GaussNewtonStep> || RobustCost<Kernel>,
                "Icp: an optimizer that compares costs needs a Kernel with `double cost(double squared_residual) "
                "const`, as in Huber; see chainslam/core/robust_kernels.hpp");
  using MetricType = Metric;      ///< the metric
  using KernelType = Kernel;      ///< the kernel
  using RejectorType = Rejector;  ///< the rejector
  using PriorType = Prior;        ///< the prior

  /// As many as unknowns.
  static constexpr Index least_points = 6;

  Index max_iterations = 50;            ///< 0 only measures the guess
  double max_distance = 1.0;            ///< metres, between a moved source point and its match
  double translation_tolerance = 1e-3;  ///< metres, of the source's centroid in one step
  double rotation_tolerance = 1e-4;     ///< radians in one step
  double cost_tolerance = 0;            ///< relative change of the mean cost in one step; 0: not looked at
  /// Coarse stage: the initial iterations, until their steps are short, use every n-th source point; later ones use
  /// all. 1: no coarse stage.
  Index coarse_stride = 8;
  double min_overlap = 0.05;  ///< least share of source points with a match
  /// Least eigenvalue of the Hessian per inlier, rotations scaled by the source's extent: a mean squared cosine. 0.005
  /// is the square of 4 degrees, the noise of normals themselves: below it, what looks like information is mostly that
  /// noise. Metrics may have one of their own.
  double degeneracy_threshold = detail::degeneracy_threshold_of<Metric>();
  DegreesOfFreedom free{};                      ///< unless all are, steps are about the source's origin
  [[no_unique_address]] Metric metric{};        ///< with its settings
  [[no_unique_address]] Kernel kernel{};        ///< of the metric's residual, metres
  [[no_unique_address]] Rejector rejector{};    ///< with its settings
  [[no_unique_address]] Optimizer optimizer{};  ///< with its settings
  [[no_unique_address]] Prior prior{};          ///< with its settings

  /// Aligns `source` to the points of `target`, starting from `guess`.
  ///
  /// @param source    points in the source's frame, metres; NaN and infinite points are skipped. With normals or
  ///                  covariances if the metric or the rejector needs them.
  /// @param target    search over points in the target's frame, or a target that names the match itself; with normals
  ///                  or covariances if the metric needs them.
  /// @param guess     T_target_source to start from.
  /// @param executor  runs the sums; the result is bit-identical for any.
  /// @param deadline  looked at once an iteration; what it cuts short has status `cancelled`.
  /// @returns pose, information, figures and status; never throws because of point data.
  /// @throws std::invalid_argument if an option or the guess makes no sense, or if a cloud lacks the normals needed.
  template <Cloud Source, AlignTarget Target, Executor Exec = Serial>
  [[nodiscard]] [[gnu::cold]] AlignResult align(const Source& source, const Target& target, const SE3d& guess = {},
                                                const Exec& executor = {}, const Deadline& deadline = {}) const;

  /// The same of two plain clouds, in one go: indexes the target, and estimates the normals that the metric needs and a
  /// cloud does not have, from 10 neighbours. Needs the header chainslam/registration/align.hpp. Keep an `IndexedCloud`
  /// where several sources meet one target.
  template <Cloud Source, Cloud Target, Executor Exec = Serial>
    requires(!AlignTarget<Target>)
  [[nodiscard]] AlignResult align(const Source& source, const Target& target, const SE3d& guess = {},
                                  const Exec& executor = {}, const Deadline& deadline = {}) const;

 private:
  /// Points that the first steps are to look at, at least.
  static constexpr Index least_pilot_points = 512;

  /// The first steps: brings some of the points near, or leaves them at the guess where too few have a match.
  template <class Target, class Exec>
  [[nodiscard]] [[gnu::cold]] SE3d coarse_stage(const detail::SourceColumns& points, const Target& target,
                                                const SE3d& guess, const Exec& executor, const Deadline& deadline,
                                                Index& iterations) const;

  /// @param pilot_only  whether to end with the first short step.
  template <class Run>
  [[nodiscard]] StopReason iterate(Run& run, const Deadline& deadline, Index& iterations, bool pilot_only) const;

  [[nodiscard]] static AlignStatus status_after(StopReason stop, Index left_out) {
    if (stop == StopReason::deadline) return AlignStatus::cancelled;
    if (stop == StopReason::iteration_limit || stop == StopReason::not_started) return AlignStatus::iteration_limit;
    return left_out > 0 ? AlignStatus::degenerate : AlignStatus::converged;
  }

  [[nodiscard]] detail::SourceWants wants() const {
    constexpr Surface surface = detail::source_surface<Metric>();
    detail::SourceWants wanted{.normals = surface == Surface::normal || Rejector::needs_normals,
                               .covariances = surface == Surface::covariance,
                               .about_centroid = free.all()};
    if constexpr (requires { metric.thickness; }) wanted.thickness = metric.thickness;
    return wanted;
  }

  template <class Source, class Target>
  static constexpr void require_metric() {
    constexpr Surface of_source = detail::source_surface<Metric>(), of_target = detail::target_surface<Metric>();
    constexpr bool target_normals = of_target == Surface::normal || Rejector::needs_normals;
    constexpr bool source_normals = of_source == Surface::normal || Rejector::needs_normals;
    static_assert(SurfaceMetric<Metric> || ErrorMetric<Metric, Target>,
                  "Icp: Metric needs `evaluate(pair, terms)`, as in PointToPlane, or `error(target, match, p_target)`; "
                  "see chainslam/registration/concepts.hpp");
    static_assert(
        !target_normals || requires(const Target& t, Index i) { t.normal(i)[0]; },
        "Icp: PointToPlane needs a target with `normal(i)`, such as IndexedCloud; so do PlaneToPlane and "
        "WithinAngle");
    static_assert(
        of_target != Surface::covariance || requires(const Target& t, Index i) { t.covariance(i)(0, 0); },
        "Icp: DistributionToDistribution needs a target with `covariance(i)`, such as GaussianVoxelMap");
    static_assert(!source_normals || OrientedCloud<Source>,
                  "Icp: PlaneToPlane needs a source with normals, such as PointCloud; so does WithinAngle");
    static_assert(of_source != Surface::covariance || DistributedCloud<Source> || OrientedCloud<Source>,
                  "Icp: DistributionToDistribution needs a source with covariances or normals, such as PointCloud");
  }

  template <class Source, class Target>
  [[gnu::cold]] void check(const Source& source, const Target& target, const SE3d& guess) const;
};

template <class Metric, class Kernel, class Rejector, class Optimizer, class Prior>
template <Cloud Source, AlignTarget Target, Executor Exec>
AlignResult Icp<Metric, Kernel, Rejector, Optimizer, Prior>::align(const Source& source, const Target& target,
                                                                   const SE3d& guess, const Exec& executor,
                                                                   const Deadline& deadline) const {
  require_metric<Source, Target>();
  check(source, target, guess);
  const detail::SourceColumns points = detail::source_columns(source, wants());
  AlignResult result;
  result.T_target_source = guess;
  if (points.count < least_points || target.size() < static_cast<std::size_t>(least_points)) return result;

  SE3d start = guess;
  const bool has_coarse_stage =
      points.count >= coarse_stride * least_pilot_points && coarse_stride > 1 && max_iterations > 0;
  if (has_coarse_stage) start = coarse_stage(points, target, guess, executor, deadline, result.iterations);
  detail::IcpRun<Icp, Target, Exec> run(*this, points, target, start, degeneracy_threshold, executor);
  run.measure(has_coarse_stage);
  result.stop = iterate(run, deadline, result.iterations, false);
  if (!run.overlaps()) {
    run.count(result);
    result.status = AlignStatus::no_overlap;
    result.stop = StopReason::lost_overlap;
    return result;
  }
  run.report(result);
  result.status = status_after(result.stop, run.left_out());
  return result;
}

template <class Metric, class Kernel, class Rejector, class Optimizer, class Prior>
template <Cloud Source, Cloud Target, Executor Exec>
  requires(!AlignTarget<Target>)
AlignResult Icp<Metric, Kernel, Rejector, Optimizer, Prior>::align(const Source& source, const Target& target,
                                                                   const SE3d& guess, const Exec& executor,
                                                                   const Deadline& deadline)
const {
  static_assert(
      requires { sizeof(detail::PlainCloud<Target>); },
      "Icp: to align plain clouds, include chainslam/registration/align.hpp, or index the target: "
      "IndexedCloud");
  constexpr Surface of_source = detail::source_surface<Metric>(), of_target = detail::target_surface<Metric>();
  static_assert(of_source != Surface::covariance && of_target != Surface::covariance,
                "Icp: plain clouds have no covariances; align to a GaussianVoxelMap or to IndexedGaussians");
  const auto indexed =
      detail::PlainCloud<Target>::indexed(target, of_target == Surface::normal || Rejector::needs_normals, executor);
  if constexpr (of_source == Surface::normal || Rejector::needs_normals)
    return align(detail::PlainCloud<Source>::oriented(source, executor), indexed, guess, executor, deadline);
  else
    return align(source, indexed, guess, executor, deadline);
}

template <class Metric, class Kernel, class Rejector, class Optimizer, class Prior>
template <class Target, class Exec>
SE3d Icp<Metric, Kernel, Rejector, Optimizer, Prior>::coarse_stage(const detail::SourceColumns& points,
                                                                   const Target& target, const SE3d& guess,
                                                                   const Exec& executor, const Deadline& deadline,
                                                                   Index& iterations) const {
  const detail::SourceColumns some = detail::one_of_each(points, coarse_stride);
  // What some points tell all but do not determine is not for them to decide.
  detail::IcpRun<Icp, Target, Exec> run(*this, some, target, guess, 2 * degeneracy_threshold, executor);
  run.measure(false);
  const StopReason stop = iterate(run, deadline, iterations, true);
  return stop == StopReason::lost_overlap || !run.overlaps() ? guess : run.T_target_source();
}

template <class Metric, class Kernel, class Rejector, class Optimizer, class Prior>
template <class Run>
StopReason Icp<Metric, Kernel, Rejector, Optimizer, Prior>::iterate(Run& run, const Deadline& deadline,
                                                                    Index& iterations, bool pilot_only) const {
  double damping = optimizer.initial_damping;
  while (iterations < max_iterations) {
    if (!run.overlaps()) return StopReason::lost_overlap;
    if (deadline.passed()) return StopReason::deadline;
    const std::optional<Vector6d> step = optimizer.step(run, damping);
    if (!step) return StopReason::no_improvement;
    const double cost_before = run.mean_cost();
    const bool last = pilot_only && run.is_short(*step);
    ++iterations;
    run.move(*step);
    if (last) return StopReason::small_step;
    run.measure(!pilot_only);
    if (pilot_only) continue;
    if (detail::translation_of(*step).norm() < translation_tolerance &&
        detail::rotation_of(*step).norm() < rotation_tolerance)
      return StopReason::small_step;
    if (std::abs(run.mean_cost() - cost_before) < cost_tolerance * cost_before) return StopReason::small_improvement;
  }
  return max_iterations > 0 ? StopReason::iteration_limit : StopReason::not_started;
}

template <class Metric, class Kernel, class Rejector, class Optimizer, class Prior>
template <class Source, class Target>
void Icp<Metric, Kernel, Rejector, Optimizer, Prior>::check(const Source& source, const Target& target,
                                                            const SE3d& guess) const {
  if (!(max_distance > 0) || max_iterations < 0 || coarse_stride < 1)
    throw std::invalid_argument("Icp: max_distance and coarse_stride must be positive, max_iterations not negative");
  if (!is_finite(guess.translation()) || !is_finite(guess.rotation().quaternion().coeffs()))
    throw std::invalid_argument("Icp: the guess is not finite");
  constexpr Surface of_source = detail::source_surface<Metric>(), of_target = detail::target_surface<Metric>();
  if constexpr (requires { target.has_normals(); }) {
    if ((of_target == Surface::normal || Rejector::needs_normals) && target.size() > 0 && !target.has_normals())
      throw std::invalid_argument("Icp: the metric needs normals in the target; call estimate_normals first");
  }
  const bool source_covariances = DistributedCloud<Source>;
  if ((of_source == Surface::normal || Rejector::needs_normals ||
       (of_source == Surface::covariance && !source_covariances)) &&
      cloud_size(source) > 0 && !carries_normals(source))
    throw std::invalid_argument("Icp: the metric needs normals in the source; call estimate_normals first");
}

using PointToPlaneIcp = Icp<PointToPlane, Trivial>;
using PointToPointIcp = Icp<PointToPoint, Trivial>;
/// Generalized ICP: to a cloud with normals, from a cloud with normals.
using Gicp = Icp<PlaneToPlane, Trivial>;
/// Voxelized GICP (Koide et al. 2021): to a `GaussianVoxelMap`, from a cloud with normals or covariances.
using Vgicp = Icp<DistributionToDistribution, Trivial>;

namespace detail {
inline constexpr Icp<PointToPlane, Huber> robust_to_planes{.kernel = {.width = 0.1}};
}

/// Aligns `source` to `target` with good defaults: to planes, robustly, where the target has normals; else to points.
/// See `Icp::align`.
template <Cloud Source, NearestNeighborSearch Target, Executor Exec = Serial>
[[nodiscard]] AlignResult align(const Source& source, const Target& target, const SE3d& guess = {},
                                const Exec& executor = {}) {
  if constexpr (OrientedSearch<Target>) {
    bool oriented = true;
    if constexpr (requires { target.has_normals(); }) oriented = target.has_normals();
    if (oriented) return detail::robust_to_planes.align(source, target, guess, executor);
  }
  return PointToPointIcp{}.align(source, target, guess, executor);
}

#ifdef CHAINSLAM_COMPILED
extern template AlignResult Icp<PointToPlane, GemanMcClure>::align(const PointCloud<float>&, const IndexedCloud<>&,
                                                                   const SE3d&, const Serial&, const Deadline&) const;
extern template AlignResult Icp<PointToPlane, GemanMcClure>::align(const PointCloud<float>&, const IndexedCloud<>&,
                                                                   const SE3d&, const ThreadPool&,
                                                                   const Deadline&) const;
extern template AlignResult Icp<PointToPlane, Huber>::align(const PointCloud<float>&, const IndexedCloud<>&,
                                                            const SE3d&, const Serial&, const Deadline&) const;
extern template AlignResult Icp<PointToPlane, Huber>::align(const PointCloud<float>&, const IndexedCloud<>&,
                                                            const SE3d&, const ThreadPool&, const Deadline&) const;
extern template AlignResult PointToPlaneIcp::align(const PointCloud<float>&, const IndexedCloud<>&, const SE3d&,
                                                   const Serial&, const Deadline&) const;
extern template AlignResult PointToPlaneIcp::align(const PointCloud<float>&, const IndexedCloud<>&, const SE3d&,
                                                   const ThreadPool&, const Deadline&) const;
extern template AlignResult PointToPointIcp::align(const PointCloud<float>&, const IndexedCloud<>&, const SE3d&,
                                                   const Serial&, const Deadline&) const;
extern template AlignResult PointToPointIcp::align(const PointCloud<float>&, const IndexedCloud<>&, const SE3d&,
                                                   const ThreadPool&, const Deadline&) const;
#endif

}  // namespace chainslam
