#pragma once

#include <Eigen/Core>
#include <cmath>
#include <stdexcept>
#include <utility>
#include <vector>

#include "chainslam/core/finite.hpp"
#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/features/normals.hpp"
#include "chainslam/registration/concepts.hpp"
#include "chainslam/registration/detail/match_cache.hpp"
#include "chainslam/registration/detail/normal_equations.hpp"
#include "chainslam/registration/point_to_plane.hpp"
#include "chainslam/registration/point_to_point.hpp"
#include "chainslam/search/indexed_cloud.hpp"

namespace chainslam {

/// Iterative closest points: matches every source point with its nearest target point, takes a Gauss-Newton step on
/// SE(3), and again (Besl and McKay 1992; Chen and Medioni 1992).
///
/// Steps are right perturbations about the source's centroid, so that neither the frame's origin nor the point count
/// changes what the thresholds mean. Directions that the points do not determine are left at the guess and reported.
/// Searches whose answer cannot have changed are spared without changing the result.
template <class Metric = PointToPlane, class Kernel = Trivial>
struct Icp {
  static_assert(RobustKernel<Kernel>, "Icp: Kernel needs `double weight(double squared_residual) const`, as in Huber");

  Index max_iterations = 50;            ///< 0 only measures the guess
  double max_distance = 1.0;            ///< metres, between a moved source point and its match
  double translation_tolerance = 1e-3;  ///< metres, of the source's centroid in one step
  double rotation_tolerance = 1e-4;     ///< radians in one step
  double min_overlap = 0.05;            ///< least share of source points with a match
  /// Least eigenvalue of the Hessian per inlier, rotations scaled by the source's extent: a mean squared cosine. 0.005
  /// is the square of 4 degrees, the noise of normals themselves: below it, what looks like information is mostly that
  /// noise.
  double degeneracy_threshold = 0.005;
  [[no_unique_address]] Metric metric{};
  [[no_unique_address]] Kernel kernel{};  ///< of the metric's residual, metres

  /// Aligns `source` to the points of `target`, starting from `guess`.
  ///
  /// @param source    points in the source's frame, metres; NaN and infinite points are skipped.
  /// @param target    search over points in the target's frame; with normals if the metric needs them.
  /// @param guess     T_target_source to start from.
  /// @param executor  runs the sums; the result is the same to the bit for any.
  /// @returns pose, information, figures and status; never throws for what the points are like.
  /// @throws std::invalid_argument if an option or the guess makes no sense, or if the target holds no normals.
  template <Cloud Source, NearestNeighborSearch Target, Executor Exec = Serial>
  [[nodiscard]] AlignResult align(const Source& source, const Target& target, const SE3d& guess,
                                  const Exec& executor = {}) const {
    static_assert(
        ErrorMetric<Metric, Target>,
        "Icp: Metric needs `error(target, match, p_target)` for this target; PointToPlane needs a target with "
        "`normal(i)`, such as IndexedCloud");
    check(target, guess);
    const CenteredSource points = center(source);
    AlignResult result;
    result.T_target_source = guess;
    if (to_index(points.positions.size()) < least_points || target.size() < static_cast<std::size_t>(least_points))
      return result;

    const SE3d T_source_center(SO3d(), points.center);
    SE3d T_target_center = guess * T_source_center;
    detail::MatchCache<Target> matches(target, to_index(points.positions.size()),
                                       static_cast<typename Target::Scalar>(max_distance));
    const auto measure = [&] { return linearize(points.positions, target, T_target_center, matches, executor); };
    detail::AlignmentEquations sums = measure();
    detail::RestrictedStep solution = detail::solve_restricted(sums, degeneracy_threshold);
    bool small = false;
    for (; !small && result.iterations < max_iterations && overlaps(sums, points); ++result.iterations) {
      const Vector6d step = solution.step;
      small = step.head<3>().norm() < translation_tolerance && step.tail<3>().norm() < rotation_tolerance;
      T_target_center = T_target_center.retract(step);
      sums = measure();
      solution = detail::solve_restricted(sums, degeneracy_threshold);
    }
    if (!overlaps(sums, points)) {
      result.status = AlignStatus::no_overlap;
      result.inliers = sums.inliers;
      result.inlier_ratio = ratio(sums, points);
      return result;
    }
    report(result, sums, solution, points);
    result.T_target_source = T_target_center * T_source_center.inverse();
    if (small)
      result.status = solution.left_out > 0 ? AlignStatus::degenerate : AlignStatus::converged;
    else
      result.status = AlignStatus::iteration_limit;
    return result;
  }

 private:
  static constexpr Index least_points = 6;  ///< as many as unknowns

  struct CenteredSource {
    Eigen::Vector3d center = Eigen::Vector3d::Zero();
    std::vector<Eigen::Vector3d> positions;  ///< the finite points minus the center
  };

  template <class Target>
  void check(const Target& target, const SE3d& guess) const {
    if (!(max_distance > 0) || max_iterations < 0)
      throw std::invalid_argument("Icp: max_distance must be positive, max_iterations not negative");
    if (!is_finite(guess.matrix())) throw std::invalid_argument("Icp: the guess is not finite");
    if constexpr (std::same_as<Metric, PointToPlane> && requires { target.has_normals(); }) {
      if (target.size() > 0 && !target.has_normals())
        throw std::invalid_argument("Icp: PointToPlane needs normals in the target; call estimate_normals first");
    }
  }

  template <class Source>
  [[nodiscard]] static CenteredSource center(const Source& source) {
    const std::size_t count = cloud_size(source);
    CenteredSource result;
    result.positions.reserve(count);
    for (std::size_t i = 0; i < count; ++i) {
      const Eigen::Vector3d p = position(source, i);
      if (is_finite(p)) result.positions.push_back(p);
    }
    for (const Eigen::Vector3d& p : result.positions) result.center += p;
    if (!result.positions.empty()) result.center /= static_cast<double>(result.positions.size());
    for (Eigen::Vector3d& p : result.positions) p -= result.center;
    return result;
  }

  [[nodiscard]] static double ratio(const detail::AlignmentEquations& sums, const CenteredSource& points) {
    return static_cast<double>(sums.inliers) / static_cast<double>(points.positions.size());
  }

  [[nodiscard]] bool overlaps(const detail::AlignmentEquations& sums, const CenteredSource& points) const {
    return sums.inliers >= least_points && ratio(sums, points) >= min_overlap;
  }

  /// Sums over all pairs at the pose T, tangent about the source's center. With e(p) and p = T exp(xi) x,
  /// de / dxi = (de / dp) R [I, -hat(x)].
  template <class Target, class Exec>
  [[nodiscard]] detail::AlignmentEquations linearize(const std::vector<Eigen::Vector3d>& points, const Target& target,
                                                     const SE3d& T, detail::MatchCache<Target>& matches,
                                                     const Exec& executor) const {
    using Scalar = typename Target::Scalar;
    constexpr Index grain = 512;
    const Eigen::Matrix3d R = T.rotation().matrix();
    const Eigen::Vector3d t = T.translation();
    const auto sum_chunk = [&](Index begin, Index end) {
      detail::AlignmentEquations sums;
      for (Index i = begin; i < end; ++i) {
        const Eigen::Vector3d& x = points[static_cast<std::size_t>(i)];
        const Eigen::Vector3d p = R * x + t;
        const auto match = matches.find(i, p.cast<Scalar>());
        if (match.index < 0) continue;
        const auto error = metric.error(target, match.index, p);
        const double squared_residual = error.residual.squaredNorm();
        const double weight = kernel.weight(squared_residual);
        for (Eigen::Index row = 0; row < error.residual.rows(); ++row) {
          const Eigen::Vector3d a = R.transpose() * error.gradient.row(row).transpose();
          Vector6d jacobian;
          jacobian << a, x.cross(a);
          const Vector6d weighted = weight * jacobian;
          sums.hessian.noalias() += jacobian * weighted.transpose();
          sums.gradient += weighted * error.residual[row];
        }
        sums.weight += weight;
        sums.squared_residual += squared_residual;
        sums.squared_distance += static_cast<double>(match.squared_distance);
        sums.squared_extent += x.squaredNorm();
        ++sums.inliers;
      }
      return sums;
    };
    return reduce_chunks(
        executor, to_index(points.size()), grain, detail::AlignmentEquations{}, sum_chunk,
        [](detail::AlignmentEquations left, const detail::AlignmentEquations& right) { return left += right; });
  }

  static void report(AlignResult& result, const detail::AlignmentEquations& sums,
                     const detail::RestrictedStep& solution, const CenteredSource& points) {
    const auto inliers = static_cast<double>(sums.inliers);
    // A perturbation xi of the source's frame is Ad(T_center_source) xi of the centered one.
    const Matrix6d Ad = SE3d(SO3d(), -points.center).adjoint();
    result.hessian = Ad.transpose() * solution.hessian * Ad;
    result.eigenvalues = solution.eigenvalues;
    result.degenerate_directions = solution.left_out;
    result.inliers = sums.inliers;
    result.inlier_ratio = ratio(sums, points);
    result.mean_squared_error = sums.squared_distance / inliers;
    result.mean_squared_residual = sums.squared_residual / inliers;
  }
};

using PointToPlaneIcp = Icp<PointToPlane, Trivial>;
using PointToPointIcp = Icp<PointToPoint, Trivial>;

/// Aligns `source` to `target` with good defaults: to planes, robustly, where the target has normals; else to points.
/// See `Icp::align`.
template <Cloud Source, NearestNeighborSearch Target, Executor Exec = Serial>
[[nodiscard]] AlignResult align(const Source& source, const Target& target, const SE3d& guess = {},
                                const Exec& executor = {}) {
  if constexpr (OrientedSearch<Target>) {
    bool oriented = true;
    if constexpr (requires { target.has_normals(); }) oriented = target.has_normals();
    const Icp<PointToPlane, Huber> icp{.kernel = {.width = 0.1}};
    if (oriented) return icp.align(source, target, guess, executor);
  }
  return PointToPointIcp{}.align(source, target, guess, executor);
}

/// The same for two clouds, in one go: indexes the target and estimates its normals first. Keep an `IndexedCloud` where
/// several sources meet one target, and make large clouds smaller with `voxel_downsample`.
template <Cloud Source, Cloud Target, Executor Exec = Serial>
  requires(!NearestNeighborSearch<Target>)
[[nodiscard]] AlignResult align(const Source& source, const Target& target, const SE3d& guess = {},
                                const Exec& executor = {}) {
  PointCloud<float> oriented;
  oriented.positions.reserve(cloud_size(target));
  for (std::size_t i = 0; i < cloud_size(target); ++i) oriented.positions.push_back(position_f(target, i));
  estimate_normals(oriented, {.neighbors = 10}, Eigen::Vector3d::Zero(), executor);
  return align(source, IndexedCloud<>(std::move(oriented)), guess, executor);
}

}  // namespace chainslam
