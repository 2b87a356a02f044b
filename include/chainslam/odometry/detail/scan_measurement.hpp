#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/odometry/detail/coarse_to_fine.hpp"
#include "chainslam/odometry/detail/moved_distance.hpp"
#include "chainslam/odometry/detail/plane_matches.hpp"
#include "chainslam/odometry/detail/pose_information.hpp"
#include "chainslam/odometry/ieskf.hpp"
#include "chainslam/odometry/imu_process.hpp"
#include "chainslam/odometry/inertial_motion_options.hpp"
#include "chainslam/odometry/scan_to_map.hpp"

namespace chainslam::detail {

/// What is known of a scan before it is matched.
struct ScanPrior {
  InertialState state{};   ///< by which it was corrected for motion
  double error = 0;        ///< metres: how far that may put a point from its place
  double variance = 1e-3;  ///< of a residual, m^2 (FAST-LIO2's code: 0.001)
  double mean_age = 0;     ///< seconds from the points' mean time to the sweep's end
};

/// A scan measured by its points' distances to planes of the local map: the `MeasurementModel` of LiDAR-inertial
/// odometry (FAST-LIO2, section V-B), made as robust as `ScanToMap`.
///
/// A wrong velocity turns up in a scan that it has undistorted: the scan as a whole then lies where it lay at its mean
/// time. With this lever the residuals depend on the velocity as well, and the filter does not take for a change of
/// position what is one of velocity.
///
/// Directions in which planes say no more than their own noise are left out of what `linearize` returns. Neighbours are
/// looked up again where the pose has moved or come to rest, starting from those found before; a plane is fitted again
/// only if they changed.
template <Cloud Scan, NearestNeighborSearch Map, class Kernel, Executor E>
class ScanMeasurement {
 public:
  using Rule = ScanToMap<Kernel>;  ///< registration rule

  /// All by reference, to outlive the measurement. @param scan  n points, body frame at the sweep's end, all finite.
  ScanMeasurement(const Scan& scan, const Map& map, const Rule& rule, const ScanMeasurementOptions& options,
                  const ScanPrior& prior, const E& executor)
      : scan_(scan),
        map_(map),
        rule_(rule),
        options_(options),
        prior_(prior),
        executor_(executor),
        schedule_(options.coarse_to_fine ? prior.error : 0.0, rule) {}

  /// Matches the scan at x, or keeps the last matches, and linearizes; see `MeasurementModel`.
  [[nodiscard]] Linearization<InertialState> linearize(const InertialState& x, bool renew);

  /// The pose at which a state puts the scan.
  [[nodiscard]] SE3d pose(const InertialState& x) const {
    const SE3d T = T_odom_body(x) * T_body_lidar(x) * T_body_lidar(prior_.state).inverse();
    const Eigen::Vector3d lag = scaled(age(), difference_of(velocity(x), velocity(prior_.state)));
    return SE3d(T.rotation(), difference_of(T.translation(), lag));
  }
  /// d pose(x) / d x.
  [[nodiscard]] Eigen::Matrix<double, 6, InertialState::dof> pose_jacobian(const InertialState& x) const {
    Eigen::Matrix<double, 6, InertialState::dof> jacobian =
        product(T_body_lidar(prior_.state).adjoint(), lidar_pose_jacobian(x));
    const Eigen::Matrix3d by_velocity = scaled(-age(), pose(x).rotation().inverse().matrix());
    set_block(jacobian, 0, inertial_offset<Inertial::velocity>, by_velocity);
    return jacobian;
  }

  /// Figures of the last pass; `T_map_body` and `covariance` stay to be filled in.
  [[nodiscard]] const ScanMatch& match() const { return match_; }
  /// Where the scan would lie by its matches alone; directions that they do not show are left as they were.
  [[nodiscard]] const SE3d& own_pose() const { return own_pose_; }
  /// By how much the squared error exceeds the least that a pose of the scan's own choice would leave.
  [[nodiscard]] double excess() const { return excess_; }

 private:
  [[nodiscard]] static Eigen::Vector3d velocity(const InertialState& x) { return x.get<Inertial::velocity>().value(); }
  [[nodiscard]] double age() const { return options_.mean_time ? prior_.mean_age : 0.0; }

  /// How far the matched points have moved since planes were looked up, metres.
  [[nodiscard]] double moved_to(const SE3d& T) const { return detail::moved_distance(T_matched_.local(T), lever_); }
  [[nodiscard]] bool wants_planes(const SE3d& T, bool renew) const {
    if (matchings_ == 0) return true;
    if (!schedule_.coarse() && fine_matchings_ == rule_.max_matchings) return false;
    const double moved = moved_to(T);
    return ((renew || schedule_.coarse()) && moved > options_.fresh_distance) || moved > rule_.rematch_distance;
  }

  const Scan& scan_;
  const Map& map_;
  const Rule& rule_;
  ScanMeasurementOptions options_;
  ScanPrior prior_;
  const E& executor_;
  std::vector<detail::FormerNeighbors<typename Map::Scalar, Rule::neighbors>> neighbors_;
  std::vector<detail::MatchedPlane> planes_;
  detail::CoarseToFine schedule_;
  double lever_ = 1;  ///< metres: range of the matched points
  SE3d T_matched_;    ///< where planes were looked up
  SE3d T_before_;     ///< of the last iteration
  Index matchings_ = 0, fine_matchings_ = 0;
  ScanMatch match_;
  double excess_ = 0;
  SE3d own_pose_;
};

template <Cloud Scan, NearestNeighborSearch Map, class Kernel, Executor E>
Linearization<InertialState> ScanMeasurement<Scan, Map, Kernel, E>::linearize(const InertialState& x, bool renew) {
  const SE3d T = pose(x);
  if (match_.iterations > 0) schedule_.follow(detail::moved_distance(T_before_.local(T), lever_));
  T_before_ = T;
  const bool looked_up = wants_planes(T, renew);
  if (looked_up) {
    const detail::PlaneRule plane = rule_.plane_rule(schedule_.error(), options_.planes);
    detail::match_planes<Rule::neighbors>(scan_, map_, T, plane, neighbors_, planes_, executor_);
    T_matched_ = T;
    ++matchings_;
    if (!schedule_.coarse()) ++fine_matchings_;
  }
  const double unit = std::max(rule_.residual_scale, 0.5 * schedule_.error());
  const auto in_gate = [&](double range) { return std::max(rule_.gate * std::sqrt(range), schedule_.error()); };
  const auto weight = [&](double squared) { return rule_.kernel.weight(squared / (unit * unit)); };
  const detail::PlaneEquations sum = detail::plane_equations(scan_, planes_, T, in_gate, weight, executor_);
  ++match_.iterations;
  match_.matches = sum.matches;
  match_.weight = sum.weight;
  Linearization<InertialState> answer;
  if (sum.matches < rule_.min_matches || !(sum.weight > 0)) {
    match_.status = ScanMatchStatus::too_few_matches;
    return answer;
  }
  const detail::PoseInformation information(sum, rule_.min_signal);
  lever_ = information.lever;
  match_.status = ScanMatchStatus::iteration_limit;
  match_.residual_rms = std::sqrt(sum.squared_residuals / sum.weight);
  match_.signal = information.signal;
  match_.degenerate_directions = information.degenerate;

  const Vector6d to_own_pose = information.step(sum.gradient);
  own_pose_ = T.retract(to_own_pose);
  excess_ = -transposed_product(to_own_pose, sum.gradient)(0, 0) / prior_.variance;
  const Eigen::Matrix<double, 6, InertialState::dof> J = pose_jacobian(x);
  const Eigen::Matrix<double, InertialState::dof, 6> J_transposed = scaled(1 / prior_.variance, transposed(J));
  answer.information = product(J_transposed, product(information.seen_hessian(), J));
  answer.gradient = negative(product(J_transposed, information.seen_gradient(sum.gradient)));
  answer.squared_error = sum.squared_residuals / prior_.variance;
  answer.residuals = sum.matches;
  const bool fresh = looked_up || fine_matchings_ == rule_.max_matchings || moved_to(T) <= options_.fresh_distance;
  answer.settled = !schedule_.coarse() && fresh;
  return answer;
}

}  // namespace chainslam::detail
