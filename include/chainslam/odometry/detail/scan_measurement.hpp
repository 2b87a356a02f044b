#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/odometry/detail/coarse_to_fine.hpp"
#include "chainslam/odometry/detail/moved_distance.hpp"
#include "chainslam/odometry/detail/pose_information.hpp"
#include "chainslam/odometry/detail/scan_clock.hpp"
#include "chainslam/odometry/detail/scan_planes.hpp"
#include "chainslam/odometry/ieskf.hpp"
#include "chainslam/odometry/imu_process.hpp"
#include "chainslam/odometry/inertial_motion_options.hpp"
#include "chainslam/odometry/scan_to_map.hpp"

namespace chainslam::detail {

/// What is known of a scan before it is matched.
struct ScanPrior {
  InertialState state{};                            ///< by which it was corrected for motion
  double error = 0;                                 ///< metres: how far that may put a point from its place
  double variance = 1e-3;                           ///< of a residual, m^2 (FAST-LIO2's code: 0.001)
  double mean_age = 0;                              ///< seconds from the points' mean time to the sweep's end
  double time_deviation = 0;                        ///< seconds: of the scan's time; 0: it is exact
  Eigen::Vector3d rate = zeros<Eigen::Vector3d>();  ///< rad/s, body frame: at the sweep's end
};

/// A scan measured by its points' distances to planes of the local map: the `MeasurementModel` of LiDAR-inertial
/// odometry (FAST-LIO2, section V-B), made as robust as `ScanToMap`.
///
/// A wrong velocity turns up in a scan that it has undistorted: the scan as a whole then lies where it lay at its mean
/// time. With this lever the residuals depend on the velocity as well, and the filter does not take for a change of
/// position what is one of velocity.
///
/// Where the time of the scan is not exact, its error is estimated as well: the scan lies where the body was then.
/// Without any IMU nothing tells it from a change of speed.
///
/// Directions in which planes say no more than their own noise are left out of what `linearize` returns. Neighbours are
/// looked up again where the pose has moved or come to rest, of points that may have others now; a plane is fitted
/// again only if they changed.
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
        planes_(scan, T_odom_body(prior.state).translation()),
        schedule_(options.coarse_to_fine ? prior.error : 0.0, rule),
        time_error_(prior.time_deviation) {}

  /// Matches the scan at x, or keeps the last matches, and linearizes; see `MeasurementModel`.
  [[nodiscard]] Linearization<InertialState> linearize(const InertialState& x, bool renew);

  /// The pose at which a state puts the scan.
  [[nodiscard]] SE3d pose(const InertialState& x) const {
    const SE3d T = T_odom_body(x) * T_body_lidar(x) * T_body_lidar(prior_.state).inverse();
    const Eigen::Vector3d lag = scaled(age(), difference_of(velocity(x), velocity(prior_.state)));
    return motion(x).later(SE3d(T.rotation(), difference_of(T.translation(), lag)), time_error_.value());
  }
  /// d pose(x) / d x.
  [[nodiscard]] Eigen::Matrix<double, 6, InertialState::dof> pose_jacobian(const InertialState& x) const {
    Matrix6d to_scan = T_body_lidar(prior_.state).adjoint();
    if (!time_error_.exact())
      to_scan = product(SE3d(motion(x).turn(-time_error_.value()), zeros<Eigen::Vector3d>()).adjoint(), to_scan);
    Eigen::Matrix<double, 6, InertialState::dof> jacobian = product(to_scan, lidar_pose_jacobian(x));
    const Eigen::Matrix3d by_velocity = scaled(time_error_.value() - age(), pose(x).rotation().inverse().matrix());
    set_block(jacobian, 0, inertial_offset<Inertial::velocity>, by_velocity);
    return jacobian;
  }
  /// d pose(x) / d time.
  [[nodiscard]] Vector6d pose_by_time(const InertialState& x) const { return motion(x).twist(pose(x).rotation()); }
  /// Seconds that the scan was taken later than stated, once the state is final.
  [[nodiscard]] double time_error(const InertialState& x) {
    follow(x);
    return time_error_.value();
  }

  /// Figures of the last pass; `T_map_body` and `covariance` stay to be filled in.
  [[nodiscard]] const ScanMatch& match() const { return match_; }
  /// Where the scan would lie by its matches alone; directions that they do not show are left as they were.
  [[nodiscard]] const SE3d& own_pose() const { return own_pose_; }
  /// By how much the squared error exceeds the least that a pose of the scan's own choice would leave.
  [[nodiscard]] double excess() const { return excess_; }

 private:
  [[nodiscard]] static Eigen::Vector3d velocity(const InertialState& x) { return x.get<Inertial::velocity>().value(); }
  [[nodiscard]] MomentaryMotion motion(const InertialState& x) const { return {velocity(x), prior_.rate}; }
  /// Goes on to the time error that goes with x.
  void follow(const InertialState& x) {
    if (match_.iterations > 0 && !time_error_.exact()) time_error_.follow(T_before_.local(pose(x)));
  }
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
  detail::ScanPlanes<typename Map::Scalar, Rule::neighbors> planes_;
  detail::CoarseToFine schedule_;
  double lever_ = 1;  ///< metres: range of the matched points
  SE3d T_matched_;    ///< where planes were looked up
  SE3d T_before_;     ///< of the last iteration
  Index matchings_ = 0, fine_matchings_ = 0;
  ScanMatch match_;
  double excess_ = 0;
  SE3d own_pose_;
  TimeError time_error_;
};

template <Cloud Scan, NearestNeighborSearch Map, class Kernel, Executor E>
Linearization<InertialState> ScanMeasurement<Scan, Map, Kernel, E>::linearize(const InertialState& x, bool renew) {
  follow(x);
  const SE3d T = pose(x);
  if (match_.iterations > 0) schedule_.follow(detail::moved_distance(T_before_.local(T), lever_));
  T_before_ = T;
  const bool looked_up = wants_planes(T, renew);
  if (looked_up) {
    const detail::PlaneRule plane = rule_.plane_rule(schedule_.error(), options_.planes);
    planes_.match(scan_, map_, T, plane, executor_);
    T_matched_ = T;
    ++matchings_;
    if (!schedule_.coarse()) ++fine_matchings_;
  }
  const double unit = std::max(rule_.residual_scale, 0.5 * schedule_.error());
  const auto weight = [&](double squared) { return rule_.kernel.weight(squared / (unit * unit)); };
  const detail::PlaneEquations sum = planes_.equations(T, {rule_.gate, schedule_.error()}, weight, executor_);
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
  excess_ = -transposed_product(to_own_pose, sum.gradient)(0, 0) / prior_.variance + time_error_.squared_error();
  Matrix6d H = scaled(1 / prior_.variance, information.seen_hessian());
  Vector6d g = scaled(-1 / prior_.variance, information.seen_gradient(sum.gradient));
  answer.squared_error = sum.squared_residuals / prior_.variance;
  const Vector6d by_time = pose_by_time(x);
  time_error_.eliminate(by_time, H, g, answer.squared_error);
  const Eigen::Matrix<double, 6, InertialState::dof> J = pose_jacobian(x);
  const Eigen::Matrix<double, InertialState::dof, 6> J_transposed = transposed(J);
  answer.information = product(J_transposed, product(H, J));
  answer.gradient = product(J_transposed, g);
  answer.residuals = sum.matches;
  const bool fresh = looked_up || fine_matchings_ == rule_.max_matchings || moved_to(T) <= options_.fresh_distance;
  const bool timed = moved_distance(scaled(time_error_.step(), by_time), lever_) <= rule_.rematch_distance;
  answer.settled = !schedule_.coarse() && fresh && timed;
  return answer;
}

}  // namespace chainslam::detail
