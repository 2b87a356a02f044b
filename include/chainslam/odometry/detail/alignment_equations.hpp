#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <optional>
#include <span>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/so3.hpp"
#include "chainslam/odometry/detail/alignment_pose.hpp"
#include "chainslam/odometry/detail/imu_track.hpp"

namespace chainslam::detail {

/// What is estimated. Tangent: offset, rotation (right, LiDAR axes), gyroscope bias, accelerometer bias.
struct AlignmentState {
  static constexpr int dof = 10;
  double time_offset = 0;  ///< s, the stamp of an IMU measurement less its time on the LiDAR's clock
  SO3d R_body_lidar;
  Eigen::Vector3d gyro_bias = Eigen::Vector3d::Zero();   ///< rad/s
  Eigen::Vector3d accel_bias = Eigen::Vector3d::Zero();  ///< m/s^2
};
using AlignmentVector = Eigen::Matrix<double, AlignmentState::dof, 1>;
using AlignmentMatrix = Eigen::Matrix<double, AlignmentState::dof, AlignmentState::dof>;

/// A^-1 of a positive definite matrix.
template <int N>
[[nodiscard]] Eigen::Matrix<double, N, N> spd_inverse(const Eigen::Matrix<double, N, N>& A) {
  const Eigen::Matrix<double, N, N> root = solved_right(identity<Eigen::Matrix<double, N, N>>(), cholesky(A));
  return times_transposed(root, root);
}

[[nodiscard]] inline AlignmentState retract(const AlignmentState& x, const AlignmentVector& step) {
  return {.time_offset = x.time_offset + step[0],
          .R_body_lidar = x.R_body_lidar.retract(block_of<3, 1>(step, 1, 0)),
          .gyro_bias = sum_of(x.gyro_bias, block_of<3, 1>(step, 4, 0)),
          .accel_bias = sum_of(x.accel_bias, block_of<3, 1>(step, 7, 0))};
}

[[nodiscard]] inline AlignmentVector local(const AlignmentState& x, const AlignmentState& y) {
  AlignmentVector step;
  step[0] = y.time_offset - x.time_offset;
  set_block(step, 1, 0, x.R_body_lidar.local(y.R_body_lidar));
  set_block(step, 4, 0, difference_of(y.gyro_bias, x.gyro_bias));
  set_block(step, 7, 0, difference_of(y.accel_bias, x.accel_bias));
  return step;
}

/// Residuals of one pose, body measurements turned into the LiDAR's axes less the LiDAR's own.
struct AlignmentResidual {
  Eigen::Vector3d value;
  Eigen::Matrix<double, 3, AlignmentState::dof> by_state;
};

/// The rotation since a pose before, R_body_lidar^T log(R_body(t_i)^T R_body(t_j)) - turn, less its bias.
[[nodiscard]] inline Eigen::Vector3d body_turn(const TrackPoint& from, const TrackPoint& to) {
  return (from.R.inverse() * to.R).log();
}
/// Mean specific force around the middle point, in the body's axes there: the second difference of the doubly
/// integrated force, in which unknown velocity and position cancel.
[[nodiscard]] inline Eigen::Vector3d body_force(const TrackPoint& left, const TrackPoint& middle,
                                                const TrackPoint& right, double before, double after) {
  return middle.R.inverse() *
         second_difference(left.force_integral2, middle.force_integral2, right.force_integral2, before, after);
}

/// Points of the IMU's track at the times of the poses, for one time offset.
using TrackPoints = std::vector<std::optional<TrackPoint>>;

/// Those of poses [begin, end).
inline void find_points(const ImuTrack& track, std::span<const AlignmentPose> poses, double offset, Index begin,
                        Index end, TrackPoints& points) {
  std::size_t hint = 0;
  for (auto j = static_cast<std::size_t>(begin); j < static_cast<std::size_t>(end); ++j)
    points[j] = track.at(poses[j].time + offset, hint);
}

/// Whether one run of the track covers all these points.
[[nodiscard]] inline bool in_one_run(const TrackPoints& points, std::size_t first, std::size_t last) {
  return points[first] && points[last] && points[first]->run == points[last]->run;
}

/// Equations of poses at a state, with the IMU's position in the LiDAR's frame (metres). Derivatives by the time offset
/// are differences over `2 * nudge`, so that the IMU's noise does not look like motion by which to tell the time.
class ImuAlignmentEquations {
 public:
  static constexpr double nudge = 0.025;  ///< s

  template <Executor E = Serial>
  ImuAlignmentEquations(const ImuTrack& track, std::span<const AlignmentPose> poses, const AlignmentState& x,
                        const Eigen::Vector3d& imu_position, const E& executor = {})
      : poses_(poses),
        x_(x),
        imu_position_(imu_position),
        now_(poses.size()),
        early_(poses.size()),
        late_(poses.size()) {
    constexpr Index grain = 64;
    executor.for_chunks(to_index(poses.size()), grain, [&](Index begin, Index end) {
      find_points(track, poses, x.time_offset, begin, end, now_);
      find_points(track, poses, x.time_offset - nudge, begin, end, early_);
      find_points(track, poses, x.time_offset + nudge, begin, end, late_);
    });
  }

  [[nodiscard]] std::optional<AlignmentResidual> turn(std::size_t j) const {
    const AlignmentPose& pose = poses_[j];
    const auto i = j - static_cast<std::size_t>(pose.turned);
    if (pose.turned == 0 || i > j || !covered(i, j)) return std::nullopt;
    const TrackPoint &from = *now_[i], &to = *now_[j];
    const Eigen::Vector3d turned = body_turn(from, to);
    const Eigen::Matrix3d passed = difference_of(to.R_integral, from.R_integral);
    const Eigen::Matrix3d by_bias =
        negative(product(SO3d::right_jacobian_inverse(turned), product(to.R.inverse().matrix(), passed)));
    const Eigen::Vector3d unbiased = sum_of(turned, product(by_bias, x_.gyro_bias));
    AlignmentResidual residual = turned_to_lidar(unbiased, pose.turn);
    set_block(residual.by_state, 0, 4, product(R_lidar_body_, by_bias));
    const Eigen::Vector3d change = difference_of(body_turn(*late_[i], *late_[j]), body_turn(*early_[i], *early_[j]));
    set_block(residual.by_state, 0, 0, product(R_lidar_body_, scaled(0.5 / nudge, change)));
    return residual;
  }

  /// Without gravity, which is to be added in the odometry's frame.
  [[nodiscard]] std::optional<AlignmentResidual> force(std::size_t j) const {
    const AlignmentPose& pose = poses_[j];
    if (pose.right == 0 || static_cast<std::size_t>(pose.left) > j) return std::nullopt;
    const std::size_t i = j - static_cast<std::size_t>(pose.left), k = j + static_cast<std::size_t>(pose.right);
    if (k >= poses_.size() || !covered(i, k) || !now_[j] || !early_[j] || !late_[j]) return std::nullopt;
    const double before = pose.time - poses_[i].time, after = poses_[k].time - pose.time;
    const auto force_of = [&](const TrackPoints& points) {
      return body_force(*points[i], *points[j], *points[k], before, after);
    };
    // The IMU's own acceleration: the LiDAR's and that of the lever arm.
    const Eigen::Vector3d accel = sum_of(pose.accel, product(pose.lever, imu_position_));
    AlignmentResidual residual = turned_to_lidar(difference_of(force_of(now_), x_.accel_bias), accel);
    set_block(residual.by_state, 0, 7, negative(R_lidar_body_));
    const Eigen::Vector3d change = difference_of(force_of(late_), force_of(early_));
    set_block(residual.by_state, 0, 0, product(R_lidar_body_, scaled(0.5 / nudge, change)));
    return residual;
  }

 private:
  [[nodiscard]] bool covered(std::size_t first, std::size_t last) const {
    return in_one_run(now_, first, last) && in_one_run(early_, first, last) && in_one_run(late_, first, last);
  }

  [[nodiscard]] AlignmentResidual turned_to_lidar(const Eigen::Vector3d& body, const Eigen::Vector3d& lidar) const {
    AlignmentResidual residual;
    const Eigen::Vector3d turned = product(R_lidar_body_, body);
    residual.value = difference_of(turned, lidar);
    residual.by_state = zeros<Eigen::Matrix<double, 3, AlignmentState::dof>>();
    set_block(residual.by_state, 0, 1, SO3d::hat(turned));
    return residual;
  }

  std::span<const AlignmentPose> poses_;
  AlignmentState x_;
  Eigen::Vector3d imu_position_;
  Eigen::Matrix3d R_lidar_body_ = x_.R_body_lidar.inverse().matrix();
  TrackPoints now_, early_, late_;
};

}  // namespace chainslam::detail
