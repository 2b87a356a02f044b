#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <type_traits>
#include <utility>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/odometry/detail/coarse_to_fine.hpp"
#include "chainslam/odometry/detail/moved_distance.hpp"
#include "chainslam/odometry/detail/plane_matches.hpp"
#include "chainslam/odometry/detail/pose_information.hpp"
#include "chainslam/odometry/detail/scan_planes.hpp"
#include "chainslam/search/concepts.hpp"
#include "chainslam/search/voxel_map.hpp"

namespace chainslam {

namespace detail {

/// Points of the local map about half a metre apart.
template <class Downsampling>
[[nodiscard]] constexpr Downsampling half_metre_apart() {
  if constexpr (std::is_same_v<Downsampling, VoxelMapOptions>)
    return {.voxel_size = 1.0, .max_points_per_voxel = 8, .min_spacing = 0.35};
  else
    return {.voxel_size = 0.5};
}

}  // namespace detail

/// How much of the past a local map holds.
struct LocalMapOptions {
  double radius = 150;                 ///< metres around the body, half the edge of the cube that is kept
  std::size_t max_points = 4'000'000;  ///< beyond, the cube shrinks until what is left fits
};

/// The surroundings that scans are registered to: a search structure that grows with every scan, cut to a cube around
/// the body (FAST-LIO2, section V-A) and to a number of points, so that its memory is bounded however long the drive.
template <IncrementalSearch Map>
class LocalMap {
 public:
  /// How the map downsamples.
  using Downsampling = std::remove_cvref_t<decltype(std::declval<const Map&>().downsampling())>;

  /// An empty map.
  explicit LocalMap(const Downsampling& downsampling = {}, const LocalMapOptions& options = {})
      : options_(options), points_(downsampling) {}

  /// @param scan  body frame. @param T_odom_body  of the scan.
  void extend(const PointCloud<float>& scan, const SE3d& T_odom_body) {
    points_.insert(transformed(scan.positions, T_odom_body));
    const Eigen::Vector3d& center = T_odom_body.translation();
    if (difference_of(center, center_).norm() >= 0.1 * options_.radius) {
      cut(center, options_.radius);
      center_ = center;
    }
    for (double radius = 0.9 * options_.radius; points_.size() > options_.max_points && radius > 1; radius *= 0.9)
      evicted_ += cut(center, radius);
  }

  /// Forgets all points.
  void clear() { points_ = Map(points_.downsampling()); }

  [[nodiscard]] const Map& points() const { return points_; }  ///< the points, in the map's own frame
  /// How many points had to go because there were too many.
  [[nodiscard]] std::int64_t evicted() const { return evicted_; }

 private:
  Index cut(const Eigen::Vector3d& center, double radius) {
    using Box = SearchBox<Map>;
    using Vector = SearchVector<Map>;
    const Eigen::Vector3d half(radius, radius, radius);
    return points_.erase_outside(Box(Vector(converted<typename Map::Scalar>(difference_of(center, half))),
                                     Vector(converted<typename Map::Scalar>(sum_of(center, half)))));
  }

  LocalMapOptions options_;
  Map points_;
  Eigen::Vector3d center_ = Eigen::Vector3d::Zero();  ///< where the map was last cut to its cube
  std::int64_t evicted_ = 0;
};

enum class ScanMatchStatus {
  converged,
  iteration_limit,  ///< the pose still moved by more than the tolerance; it is finite and the best at hand
  too_few_matches,  ///< the pose is the guess
};

/// Where a scan fits into the local map.
struct ScanMatch {
  SE3d T_map_body{};                                          ///< the registered pose
  ScanMatchStatus status = ScanMatchStatus::too_few_matches;  ///< how it ended
  Matrix6d covariance = identity<Matrix6d>();                 ///< of T_map_body, tangent [translation; rotation]
  Vector6d signal = zeros<Vector6d>();  ///< ascending, of six directions: information over that of pure noise
  Index degenerate_directions = 0;      ///< of six, in which the scan says nothing and the guess was kept
  Index matches = 0;                    ///< points with a plane within the gate
  double weight = 0;                    ///< of these, each weighted by the kernel: distinguishes similar places
  Index iterations = 0;                 ///< passes made
  double residual_rms = 0;              ///< metres, over matches, weighted by the kernel
};

/// Registers a scan to a growing map by point-to-plane distances: FAST-LIO2's measurement (Xu et al. 2022, section V-B)
/// in Gauss-Newton form, made robust.
///
/// Each point takes the plane through its nearest neighbours in the map. The gate on the distance to that plane and the
/// kernel's scale start at the error to be expected of the guess and shrink by half whenever the pose has converged
/// under them (`detail::CoarseToFine`), so that a bad guess (the first scans of a drive) is caught without letting
/// traffic in later. Directions in which the planes carry too little information are left at the guess (Zhang et al.
/// 2016, solution remapping) and get the guess's variance.
///
/// @tparam Kernel  its argument is the squared residual over the current scale.
template <class Kernel = GemanMcClure>
struct ScanToMap {
  static_assert(
      RobustKernel<Kernel>,
      "ScanToMap: Kernel needs `double weight(double squared_residual) const`; see chainslam/core/robust_kernels.hpp");
  static constexpr std::size_t neighbors = 5;  ///< through which planes are fitted, as in FAST-LIO2

  Index max_iterations = 20;             ///< Gauss-Newton iterations, not counting repeated coarse ones
  Index max_matchings = 4;               ///< times the planes of all points are looked up once no longer coarse
  Index max_coarse_iterations = 100;     ///< with gate and kernel held until the pose has converged under them
  double coarse_tolerance = 0.05;        ///< of the gate: converged under it if the last step was no longer
  Index min_matches = 30;                ///< with fewer, registration fails
  double max_neighbor_distance = 2.236;  ///< metres, of the fifth neighbour (FAST-LIO2: sqrt(5))
  double max_plane_deviation = 0.1;      ///< metres, of every neighbour from the plane (FAST-LIO2)
  double min_plane_width = 0.1;          ///< metres, root mean square across the plane's narrow direction: no lines
  double gate = 1.0 / 9.0;      ///< |residual| <= gate sqrt(range), metres (FAST-LIO2: 1 - 0.9 |r| / sqrt(range) > 0.9)
  double residual_scale = 0.1;  ///< metres: the kernel's unit once the pose has settled
  double translation_tolerance = 2e-3;    ///< metres, of the last step
  double rotation_tolerance = 2e-4;       ///< radians, of the last step
  double rematch_distance = 0.03;         ///< metres a point may move before its plane is looked up again
  double min_signal = 3.0;                ///< information over that of pure noise for a direction to count as seen
  double residual_floor = 0.01;           ///< metres: residuals are never trusted to be smaller than this
  double correlated_residuals = 25;       ///< neighbouring residuals err together: so many count as one
  [[no_unique_address]] Kernel kernel{};  ///< robust kernel of the distances, metres

  /// What makes a plane of neighbours in the map. @param error  metres, that a point may be off its place.
  [[nodiscard]] detail::PlaneRule plane_rule(double error, PlaneForm form = PlaneForm::centred) const {
    return {std::max(max_neighbor_distance, error), max_plane_deviation, min_plane_width, residual_floor, form};
  }

  /// @param scan         n points, body frame, metres, all finite.
  /// @param map          m points, map frame.
  /// @param guess        T_map_body to start from.
  /// @param guess_error  metres: how far the guess may put a point from its place.
  template <Cloud Scan, NearestNeighborSearch Map, Executor E = Serial>
  [[nodiscard]] ScanMatch align(const Scan& scan, const Map& map, const SE3d& guess, double guess_error,
                                const E& executor = {}) const;
};

template <class Kernel>
template <Cloud Scan, NearestNeighborSearch Map, Executor E>
ScanMatch ScanToMap<Kernel>::align(const Scan& scan, const Map& map, const SE3d& guess, double guess_error,
                                   const E& executor) const {
  ScanMatch match{.T_map_body = guess};
  detail::ScanPlanes<typename Map::Scalar, neighbors> planes(scan, guess.translation());
  detail::CoarseToFine schedule(guess_error, *this);
  double moved = 0;  // metres at the lever arm, since planes were looked up
  bool stale = true;
  Index matchings = 0;
  while (match.status != ScanMatchStatus::converged && match.iterations < max_iterations + schedule.iterations()) {
    const bool settled = !schedule.coarse();
    if (stale) {
      if (settled && matchings++ == max_matchings) break;
      const detail::PlaneRule rule = plane_rule(schedule.error());
      planes.match(scan, map, match.T_map_body, rule, executor);
      moved = 0;
    }
    const double unit = std::max(residual_scale, 0.5 * schedule.error());
    const auto weight = [&](double squared_residual) { return kernel.weight(squared_residual / (unit * unit)); };
    const detail::PlaneEquations sum = planes.equations(match.T_map_body, {gate, schedule.error()}, weight, executor);
    ++match.iterations;
    match.matches = sum.matches;
    match.weight = sum.weight;
    if (sum.matches < min_matches || !(sum.weight > 0)) {
      match.T_map_body = guess;
      match.status = ScanMatchStatus::too_few_matches;
      return match;
    }

    const detail::PoseInformation information(sum, min_signal);
    const Vector6d step = information.step(sum.gradient);
    match.T_map_body = match.T_map_body.retract(step);
    match.residual_rms = std::sqrt(sum.squared_residuals / sum.weight);
    match.signal = information.signal;
    match.degenerate_directions = information.degenerate;
    const double noise = std::max(match.residual_rms, residual_floor);
    match.covariance = information.covariance(noise * noise * correlated_residuals, guess_error * guess_error);

    const bool small = block_of<3, 1>(step, 0, 0).norm() < translation_tolerance &&
                       block_of<3, 1>(step, 3, 0).norm() < rotation_tolerance;
    const double step_length = detail::moved_distance(step, information.lever);
    moved += step_length;
    match.status = settled && small && stale ? ScanMatchStatus::converged : ScanMatchStatus::iteration_limit;
    // A small step on old planes is not yet an answer: look the planes up once more.
    stale = !settled || small || moved > rematch_distance;
    schedule.follow(step_length);
  }
  return match;
}

}  // namespace chainslam
