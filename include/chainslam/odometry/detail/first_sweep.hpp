#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <vector>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/odometry/deskew.hpp"
#include "chainslam/odometry/detail/imu_record.hpp"
#include "chainslam/odometry/detail/sweep.hpp"

namespace chainslam::detail {

/// How a body turned during a sweep, by its gyroscope alone.
class GyroTurn {
 public:
  /// @param bias  of the gyroscope, rad/s.
  GyroTurn(const ImuRecord& imu, Timestamp begin, Timestamp end, const Eigen::Vector3d& bias)
      : duration_(std::max(0.0, to_seconds(end - begin))) {
    imu.for_each_step(begin, end, [&](const ImuStep& step) {
      measured_ = measured_ && step.reading && step.reading->rate_measured;
      const Eigen::Vector3d rate = step.reading ? difference_of(step.reading->gyro, bias) : zeros<Eigen::Vector3d>();
      knots_.push_back({time_, R_begin_end_, rate});
      R_begin_end_ = R_begin_end_ * SO3d::exp(scaled(step.duration, rate));
      time_ += step.duration;
    });
    measured_ = measured_ && !knots_.empty();
  }

  /// Whether the gyroscope measured all of the sweep.
  [[nodiscard]] bool measured() const { return measured_; }

  /// The motion during the sweep. @param twist  constant, per second, body frame; its rotation counts only where the
  /// gyroscope did not measure it.
  [[nodiscard]] SweepMotion with(const Vector6d& twist) const {
    if (!measured_) return SweepMotion::constant_twist(duration_, twist);
    const Eigen::Vector3d velocity = block_of<3, 1>(twist, 0, 0);
    return SweepMotion::sample(duration_, R_begin_end_.log().norm(), [&](double offset) {
      return SE3d(R_begin_end_.inverse() * rotation(offset), scaled(offset - duration_, velocity));
    });
  }

 private:
  struct Knot {
    double time;  ///< seconds from the sweep's begin
    SO3d R_begin_body;
    Eigen::Vector3d rate;  ///< rad/s, from here to the next
  };

  [[nodiscard]] SO3d rotation(double offset) const {
    std::size_t i = knots_.size() - 1;  // there are a dozen
    while (i > 0 && knots_[i].time > offset) --i;
    const Knot& knot = knots_[i];
    return knot.R_begin_body * SO3d::exp(scaled(offset - knot.time, knot.rate));
  }

  double duration_;
  bool measured_ = true;
  double time_ = 0;
  SO3d R_begin_end_;
  std::vector<Knot> knots_;
};

/// The first sweep, kept until the motion during it is known.
struct FirstSweep {
  Sweep sweep;
  GyroTurn turn;
};

}  // namespace chainslam::detail
