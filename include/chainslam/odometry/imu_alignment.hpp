#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <deque>
#include <limits>
#include <numbers>
#include <optional>
#include <span>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/symmetric_eigen.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/lie/so3.hpp"
#include "chainslam/odometry/detail/alignment_block.hpp"
#include "chainslam/odometry/detail/alignment_equations.hpp"
#include "chainslam/odometry/detail/alignment_pose.hpp"
#include "chainslam/odometry/detail/alignment_search.hpp"
#include "chainslam/odometry/detail/alignment_solution.hpp"
#include "chainslam/odometry/detail/imu_track.hpp"
#include "chainslam/sensor/packet.hpp"

namespace chainslam {

/// By how much an IMU's clock and axes differ from what is given.
struct ImuCorrection {
  double time_offset = 0;  ///< seconds that stamps are late by, on the LiDAR's clock
  SO3d R_body_imu{};       ///< from the axes that the IMU measures along to those of the body

  /// The sample, corrected.
  [[nodiscard]] ImuSample operator()(ImuSample sample) const {
    sample.time = sample.time - seconds(time_offset);
    sample.gyro = R_body_imu * sample.gyro;
    sample.accel = R_body_imu * sample.accel;
    return sample;
  }
  /// What leads from samples corrected by `before` to such by this.
  [[nodiscard]] ImuCorrection since(const ImuCorrection& before) const {
    return {time_offset - before.time_offset, R_body_imu * before.R_body_imu.inverse()};
  }
};

/// What measurements alone say of a rotation, no prior included: a quadratic cost about a known rotation R. A step of
/// right tangent x (rad) from R costs x^T information x / 2 - vector^T x. Zero where nothing was measured.
struct RotationEvidence {
  SO3d about{};                                            ///< the rotation that tangents are about
  Eigen::Matrix3d information = zeros<Eigen::Matrix3d>();  ///< 1/rad^2
  Eigen::Vector3d vector = zeros<Eigen::Vector3d>();       ///< 1/rad

  /// As much as is left if all of it may have a common error of this deviation (rad) about each axis.
  [[nodiscard]] RotationEvidence with_common_error(double deviation) const {
    const double variance = deviation * deviation;
    const Eigen::Matrix3d less = inverse_of(sum_of(identity<Eigen::Matrix3d>(), scaled(variance, information)));
    return {about, product(less, information), product(less, vector)};
  }

  /// A^-1 of a regular matrix, by its adjugate.
  [[nodiscard]] static Eigen::Matrix3d inverse_of(const Eigen::Matrix3d& A) {
    Eigen::Matrix3d adjugate;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) {
        const int i1 = (i + 1) % 3, i2 = (i + 2) % 3, j1 = (j + 1) % 3, j2 = (j + 2) % 3;
        adjugate(j, i) = A(i1, j1) * A(i2, j2) - A(i1, j2) * A(i2, j1);
      }
    const double determinant = A(0, 0) * adjugate(0, 0) + A(0, 1) * adjugate(1, 0) + A(0, 2) * adjugate(2, 0);
    return divided(adjugate, determinant);
  }
};

/// Settings of `ImuAlignment`.
struct ImuAlignmentOptions {
  double time_offset = 0;              ///< s, given or assumed: stamp of an IMU measurement less its true time
  double time_offset_deviation = 0.1;  ///< s
  double max_time_offset = 0.25;       ///< s, either way
  SE3d T_body_lidar;                   ///< given; where the IMU sits in the LiDAR's frame is taken as it is
  double rotation_deviation = 0.05;    ///< rad, of the given rotation about each axis; infinite if it is not known
  double gyro_bias_deviation = 0.05;   ///< rad/s
  double accel_bias_deviation = 0.3;   ///< m/s^2
  double half_span = 0.5;              ///< s between the positions whose second difference is an acceleration
  double max_step = 1.5;               ///< s; poses farther apart are not compared
  double max_gap = 0.25;               ///< s between IMU measurements that are joined
  double block = 10;                   ///< s over which gravity is constant in the LiDAR odometry's frame
  double window = 60;                  ///< s of measurements kept as such; what is older is kept as equations
  double memory = 300;                 ///< s of these
  double min_duration = 1;             ///< s of poses before the first estimate
  double growth = 0.25;                ///< of the data, between estimates, ...
  double interval = 1;                 ///< ... at most so many s, ...
  double min_growth = 0.05;            ///< ... but not less than this of the data, ...
  double known_interval = 5;           ///< ... or so many s once offset and rotation are known
  double search_interval = 10;         ///< s between searches of all offsets, once offset and rotation are known
  double time_offset_floor = 0.002;    ///< s of the deviation that more data do not reduce: of the scans' own times
  double rotation_floor = 0.002;       ///< rad, likewise: of the LiDAR's calibration
  double min_contrast = 50;  ///< squared deviations by which the best offset must beat others; before, no estimate
  double known_time_offset = 0.005;     ///< s, standard deviation from which the offset counts as known
  double known_rotation = 0.01;         ///< rad, likewise, about the worst axis
  double contradiction_sigmas = 5;      ///< by so many deviations, and by so large ...
  double contradiction_angle = 0.0524;  ///< ... an angle (rad) the given rotation must be off to be contradicted
};

/// What is known of how and when the IMU measures.
struct ImuAlignmentEstimate {
  /// s: an IMU measurement's time on the LiDAR's clock is its stamp less this; positive if the IMU's stamps are late.
  double time_offset = 0;
  double time_offset_deviation = 0;                                 ///< seconds, standard deviation
  SO3d R_body_lidar;                                                ///< rotation from the LiDAR's to the body's axes
  Eigen::Matrix3d rotation_covariance = Eigen::Matrix3d::Zero();    ///< right tangent (LiDAR axes), rad^2
  Eigen::Vector3d gyro_bias = Eigen::Vector3d::Zero();              ///< rad/s
  Eigen::Matrix3d gyro_bias_covariance = Eigen::Matrix3d::Zero();   ///< (rad/s)^2
  Eigen::Vector3d accel_bias = Eigen::Vector3d::Zero();             ///< m/s^2
  Eigen::Matrix3d accel_bias_covariance = Eigen::Matrix3d::Zero();  ///< (m/s^2)^2
  Eigen::Vector3d up_odom = Eigen::Vector3d::Zero();  ///< against gravity in the newest poses' frame; 0 if unknown
  bool time_known = false;                            ///< to `known_time_offset`
  bool rotation_known = false;                        ///< to `known_rotation` about all axes
  int observed_rotation_axes = 0;                     ///< of three principal axes: known to `known_rotation`
  bool contradicted = false;       ///< the data exclude the given rotation; the estimate then leaves it out
  double contradiction_angle = 0;  ///< rad: by so much, about the axis that shows it best
  double seconds_used = 0;         ///< of poses with IMU measurements
};

/// Estimates time offset and rotation between IMU and LiDAR, and the IMU's biases, from the LiDAR's own motion.
///
/// Rotations between poses of LiDAR odometry are compared with the integrated gyroscope (Furgale et al. 2013; Zhu et
/// al. 2022, LI-Init), second differences of its positions with the integrated accelerometer, gravity free for every
/// few seconds. A search over the offset, each with the rotation in closed form, gives the start; robust Gauss-Newton
/// steps on (offset, rotation, biases) refine it. The covariance is that of M-estimators with dependent residuals
/// (sandwich, Liang and Zeger 1986: sums over blocks of time), so that it does not rest on the poses' own deviations.
///
/// Poses may come at 2 to 20 Hz, unevenly; IMU measurements before or after the poses that they go with. What the
/// motion does not show keeps the deviation of the prior. Memory is bounded; estimates come as `growth` says.
class ImuAlignment {
 public:
  /// Starts without knowledge.
  explicit ImuAlignment(const ImuAlignmentOptions& options = {}) : options_(options), track_(options.max_gap) {
    state_ = given();
    report(state_, detail::spd_inverse(given_information(options.rotation_deviation)));
  }

  /// Adds a measurement, in order of time. @returns false if it was dropped: not finite, absurd, or not later.
  bool add(const ImuSample& sample) { return track_.add(seconds_of(sample.time), sample.gyro, sample.accel); }

  /// Takes the pose of a scan, in order of time; earlier ones are ignored. An executor shares out estimates; any gives
  /// bit-identical ones. @returns whether there is a new estimate.
  template <Executor E = Serial>
  bool add(const LidarPose& pose, const E& executor = {});

  [[nodiscard]] const ImuAlignmentEstimate& estimate() const { return estimate_; }  ///< the latest estimate
  /// The same with what else is known of R_body_lidar. Both may rest on the same data: then the better one counts.
  [[nodiscard]] ImuAlignmentEstimate with(const RotationEvidence& evidence) const;
  /// Whether time offset and rotation are known.
  [[nodiscard]] bool known() const { return estimate_.time_known && estimate_.rotation_known; }

 private:
  using AlignmentState = detail::AlignmentState;
  using AlignmentVector = detail::AlignmentVector;
  using AlignmentMatrix = detail::AlignmentMatrix;

  [[nodiscard]] double seconds_of(Timestamp time) {
    if (!epoch_) epoch_ = time;
    return to_seconds(time - *epoch_);
  }
  [[nodiscard]] double pause() const;
  void forget_old();
  void forget_before(double time);
  template <Executor E>
  void solve(std::size_t count, const E& executor);
  [[nodiscard]] std::vector<std::size_t> block_ends(std::size_t count) const;
  [[nodiscard]] std::size_t covered_poses() const;
  [[nodiscard]] bool distinct() const { return contrast_ >= options_.min_contrast; }
  [[nodiscard]] AlignmentMatrix given_information(double rotation_deviation) const;
  static constexpr double any_rotation = 2;  ///< rad, of a rotation of which nothing is known
  /// Whether a start leads to another solution than the last one does.
  [[nodiscard]] bool elsewhere(const AlignmentState& start) const {
    constexpr double apart = 0.03, turned = 0.15;  // s, rad
    return std::abs(start.time_offset - state_.time_offset) > apart ||
           start.R_body_lidar.local(state_.R_body_lidar).norm() > turned;
  }
  [[nodiscard]] AlignmentState given() const {
    return {.time_offset = options_.time_offset, .R_body_lidar = options_.T_body_lidar.rotation()};
  }
  [[nodiscard]] AlignmentMatrix with_floor(AlignmentMatrix covariance) const;
  void compare_with_given(const AlignmentMatrix& covariance);
  void report(const AlignmentState& x, const AlignmentMatrix& P);
  void report_rotation(const SO3d& R, const Eigen::Matrix3d& covariance, ImuAlignmentEstimate& e) const;

  ImuAlignmentOptions options_;
  detail::ImuTrack track_;
  std::optional<Timestamp> epoch_;
  std::vector<detail::AlignmentPose> poses_;
  std::deque<detail::AlignmentBlock> old_;      ///< of poses that have left the window
  std::vector<detail::AlignmentBlock> newest_;  ///< of the window, by the last solution
  AlignmentState state_;                        ///< by the data alone
  std::optional<double> solved_at_;
  double searched_at_ = 0;
  double contrast_ = 0;  ///< the most that a search has found
  ImuAlignmentEstimate estimate_;
};

template <Executor E>
bool ImuAlignment::add(const LidarPose& pose, const E& executor) {
  const double time = seconds_of(pose.time);
  if (!is_finite(pose.T_odom_lidar.translation()) || (!poses_.empty() && !(time > poses_.back().time))) return false;
  poses_.push_back(detail::alignment_pose(pose, time));
  detail::link_to_neighbours(poses_, options_.half_span, options_.max_step, pose.time_deviation);
  if (!solved_at_) solved_at_ = time;
  if (time - *solved_at_ < pause()) return false;
  const std::size_t count = covered_poses();
  if (count == 0 || poses_[count - 1].time - poses_.front().time < options_.min_duration) return false;
  solved_at_ = time;
  solve(count, executor);
  forget_old();
  return true;
}

inline std::vector<std::size_t> ImuAlignment::block_ends(std::size_t count) const {
  std::vector<std::size_t> ends;
  for (std::size_t j = 1; j <= count; ++j)
    if (j == count || std::floor(poses_[j].time / options_.block) != std::floor(poses_[j - 1].time / options_.block))
      ends.push_back(j);
  return ends;
}

inline ImuAlignment::AlignmentMatrix ImuAlignment::given_information(double rotation_deviation) const {
  const auto weight = [](double deviation) { return 1 / (deviation * deviation); };
  AlignmentMatrix information = zeros<AlignmentMatrix>();
  information(0, 0) = weight(options_.time_offset_deviation);
  for (int i = 0; i < 3; ++i) {
    information(1 + i, 1 + i) = weight(std::min(rotation_deviation, any_rotation));
    information(4 + i, 4 + i) = weight(options_.gyro_bias_deviation);
    information(7 + i, 7 + i) = weight(options_.accel_bias_deviation);
  }
  return information;
}

/// Poses whose measurements have come for any offset.
inline std::size_t ImuAlignment::covered_poses() const {
  const double end = track_.end().value_or(-std::numeric_limits<double>::infinity());
  std::size_t count = 0;
  while (count < poses_.size() &&
         poses_[count].time + options_.max_time_offset + detail::ImuAlignmentEquations::nudge <= end)
    ++count;
  return count;
}

/// Seconds between the last estimate and the next.
inline double ImuAlignment::pause() const {
  if (known()) return options_.known_interval;
  const double data = *solved_at_ - poses_.front().time;
  return std::max(options_.min_growth * data, std::min(options_.interval, options_.growth * data));
}

template <Executor E>
void ImuAlignment::solve(std::size_t count, const E& executor) {
  const std::vector<std::size_t> ends = block_ends(count);
  detail::AlignmentProblem problem{.track = track_,
                                   .poses = std::span(poses_.data(), count),
                                   .ends = ends,
                                   .old = old_,
                                   .imu_position = options_.T_body_lidar.inverse().translation(),
                                   .given = given(),
                                   .given_information = given_information(any_rotation),
                                   .max_offset = options_.max_time_offset};
  std::vector<detail::AlignmentSolution> solutions;
  if (!known() || poses_.back().time - searched_at_ >= options_.search_interval) {
    searched_at_ = poses_.back().time;
    const auto found = detail::search_alignment(track_, problem.poses, ends, options_.max_time_offset, executor);
    if (found) contrast_ = std::max(contrast_, found->contrast);
    if (!distinct()) return;  // noise has a best offset, too
    if (found && elsewhere(found->state)) solutions.push_back(detail::refined(problem, found->state, 0, executor));
  }
  solutions.push_back(detail::refined(problem, state_, known() ? detail::wide_steps : 0, executor));
  const detail::AlignmentSolution& best = detail::best_of(solutions);
  newest_ = best.blocks;
  state_ = best.state;
  AlignmentMatrix covariance = with_floor(detail::sandwich(problem, best));
  compare_with_given(covariance);
  if (estimate_.contradicted || !std::isfinite(options_.rotation_deviation)) return report(state_, covariance);
  // With the given rotation as a prior, and from there.
  problem.rotation_given = true;
  problem.given_information = given_information(options_.rotation_deviation);
  AlignmentState start = state_;
  start.R_body_lidar = options_.T_body_lidar.rotation();
  const detail::AlignmentSolution fused = detail::refined(problem, start, 0, executor);
  report(fused.state, with_floor(detail::sandwich(problem, fused)));
}

/// Adds what more data do not reduce.
inline ImuAlignment::AlignmentMatrix ImuAlignment::with_floor(AlignmentMatrix covariance) const {
  covariance(0, 0) += options_.time_offset_floor * options_.time_offset_floor;
  for (int i = 1; i < 4; ++i) covariance(i, i) += options_.rotation_floor * options_.rotation_floor;
  return covariance;
}

inline void ImuAlignment::report(const AlignmentState& x, const AlignmentMatrix& P) {
  ImuAlignmentEstimate& e = estimate_;
  e.time_offset = x.time_offset;
  e.time_offset_deviation = std::sqrt(P(0, 0));
  report_rotation(x.R_body_lidar, block_of<3, 3>(P, 1, 1), e);
  e.gyro_bias = x.gyro_bias;
  e.gyro_bias_covariance = block_of<3, 3>(P, 4, 4);
  e.accel_bias = x.accel_bias;
  e.accel_bias_covariance = block_of<3, 3>(P, 7, 7);
  e.time_known = e.time_offset_deviation <= options_.known_time_offset;
  e.seconds_used = 0;
  const auto count_time = [&](const detail::AlignmentBlock& block) {
    if (block.turns > 0) e.seconds_used += block.end - block.begin;
  };
  std::for_each(old_.begin(), old_.end(), count_time);
  std::for_each(newest_.begin(), newest_.end(), count_time);
  for (const detail::AlignmentBlock& block : newest_)
    if (block.forces > 0) e.up_odom = block.up_force / block.up_force.norm();
}

inline void ImuAlignment::report_rotation(const SO3d& R, const Eigen::Matrix3d& covariance,
                                          ImuAlignmentEstimate& e) const {
  e.R_body_lidar = R;
  e.rotation_covariance = covariance;
  e.observed_rotation_axes = 0;
  for (const double variance : jacobi_eigen(covariance).values)
    if (variance <= options_.known_rotation * options_.known_rotation) ++e.observed_rotation_axes;
  e.rotation_known = e.observed_rotation_axes == 3;
}

inline ImuAlignmentEstimate ImuAlignment::with(const RotationEvidence& evidence) const {
  ImuAlignmentEstimate e = estimate_;
  const RotationEvidence other = evidence.with_common_error(options_.rotation_floor);
  const Eigen::Matrix3d own = detail::spd_inverse(estimate_.rotation_covariance);
  const Eigen::Matrix3d covariance = detail::spd_inverse(sum_of(own, other.information));
  const Eigen::Vector3d off = other.about.local(estimate_.R_body_lidar);
  const Eigen::Vector3d step = product(covariance, sum_of(product(own, off), other.vector));
  report_rotation(other.about.retract(step), covariance, e);
  return e;
}

/// Whether the data, which know the rotation about some axis well, exclude the one given.
inline void ImuAlignment::compare_with_given(const AlignmentMatrix& covariance) {
  const Eigen::Vector3d off = state_.R_body_lidar.local(options_.T_body_lidar.rotation());
  const JacobiEigen<double, 3> axes = jacobi_eigen(block_of<3, 3>(covariance, 1, 1));
  estimate_.contradicted = false;
  estimate_.contradiction_angle = 0;
  double worst = options_.contradiction_sigmas;
  for (int i = 0; i < 3; ++i) {
    const double angle = std::abs(block_of<3, 1>(axes.vectors, 0, i).dot(off)), deviation = std::sqrt(axes.values[i]);
    if (angle < options_.contradiction_angle || deviation > options_.contradiction_angle || angle < worst * deviation)
      continue;
    worst = angle / deviation;
    estimate_.contradicted = true;
    estimate_.contradiction_angle = angle;
  }
}

/// Keeps the equations of blocks that leave the window, and forgets their poses and measurements.
inline void ImuAlignment::forget_old() {
  const double oldest = poses_.back().time - options_.window;
  if (!distinct()) return forget_before(oldest);
  if (newest_.empty()) return;
  std::size_t gone = 0;
  while (gone + 1 < newest_.size() && newest_[gone].end < oldest) old_.push_back(newest_[gone++]);
  while (!old_.empty() && old_.front().end < oldest - options_.memory) old_.pop_front();
  if (gone == 0) return;
  newest_.erase(newest_.begin(), newest_.begin() + static_cast<std::ptrdiff_t>(gone));
  forget_before(newest_.front().begin);
}

inline void ImuAlignment::forget_before(double time) {
  const auto needed = std::find_if(poses_.begin(), poses_.end(), [&](const auto& pose) { return pose.time >= time; });
  poses_.erase(poses_.begin(), needed);
  track_.forget_before(time - options_.max_time_offset - detail::ImuAlignmentEquations::nudge);
}

}  // namespace chainslam
