#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <deque>
#include <optional>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/so3.hpp"

namespace chainslam::detail {

/// Where dead reckoning by the IMU alone has come to: integrals since the start of a run of measurements without gaps.
struct TrackPoint {
  int run = 0;
  SO3d R;                                                     ///< attitude of the body
  Eigen::Matrix3d R_integral = zeros<Eigen::Matrix3d>();      ///< of R over time, s
  Eigen::Vector3d force_integral = Eigen::Vector3d::Zero();   ///< of R times specific force, m/s
  Eigen::Vector3d force_integral2 = Eigen::Vector3d::Zero();  ///< of that again, m
};

/// The IMU's measurements as integrals from the start of each run, so that those between any two stamps follow from
/// the points at both ends: no sum over measurements for every time offset that is tried.
///
/// Rates and forces run linearly between measurements. A measurement far from both its neighbours, which agree, is
/// replaced by their mean; so each waits for the next.
class ImuTrack {
 public:
  explicit ImuTrack(double max_gap) : max_gap_(max_gap) {}

  /// @param stamp  seconds, on any origin. @returns false if it was dropped: not finite, absurd, or not later.
  bool add(double stamp, const Eigen::Vector3d& gyro, const Eigen::Vector3d& accel) {
    constexpr double absurd_rate = 100, absurd_force = 1000;  // rad/s, m/s^2: no LiDAR survives these
    if (!is_finite(gyro) || !is_finite(accel) || gyro.norm() > absurd_rate || accel.norm() > absurd_force) return false;
    if (newest_ && !(stamp > newest_->stamp)) return false;
    Measurement now{stamp, gyro, accel};
    if (newest_) {
      if (!nodes_.empty() && nodes_.back().measured.run_continues(*newest_, now, max_gap_)) {
        smooth(newest_->gyro, nodes_.back().measured.gyro, now.gyro, 1.0);
        smooth(newest_->accel, nodes_.back().measured.accel, now.accel, 20.0);
      }
      append(*newest_);
    }
    newest_ = now;
    return true;
  }

  /// The point at `stamp`, or nothing in a gap and beyond the ends. `hint` speeds up queries in ascending order.
  [[nodiscard]] std::optional<TrackPoint> at(double stamp, std::size_t& hint) const {
    if (nodes_.size() < 2 || stamp < nodes_.front().measured.stamp || stamp > nodes_.back().measured.stamp)
      return std::nullopt;
    find(stamp, hint);
    const Node &a = nodes_[hint], &b = nodes_[hint + 1];
    if (a.point.run != b.point.run) return std::nullopt;
    return advanced(a, b.measured, stamp - a.measured.stamp);
  }

  /// Last stamp that `at` answers.
  [[nodiscard]] std::optional<double> end() const {
    return nodes_.empty() ? std::nullopt : std::optional(nodes_.back().measured.stamp);
  }

  /// Forgets what queries from `stamp` on do not need.
  void forget_before(double stamp) {
    while (nodes_.size() > 2 && nodes_[1].measured.stamp <= stamp) nodes_.pop_front();
  }

 private:
  struct Measurement {
    double stamp = 0;
    Eigen::Vector3d gyro, accel;
    [[nodiscard]] bool run_continues(const Measurement& middle, const Measurement& last, double max_gap) const {
      return middle.stamp - stamp <= max_gap && last.stamp - middle.stamp <= max_gap;
    }
  };
  struct Node {
    Measurement measured;
    TrackPoint point;
  };

  /// Replaces `middle` by the mean of both neighbours if it is off by far more than they differ.
  static void smooth(Eigen::Vector3d& middle, const Eigen::Vector3d& before, const Eigen::Vector3d& after,
                     double allowed) {
    const double limit = allowed + 4 * difference_of(after, before).norm();
    if (difference_of(middle, before).norm() > limit && difference_of(middle, after).norm() > limit)
      middle = scaled(0.5, sum_of(before, after));
  }

  void append(const Measurement& measured) {
    Node node{measured, {}};
    if (!nodes_.empty()) {
      const Node& last = nodes_.back();
      const double step = measured.stamp - last.measured.stamp;
      if (step <= max_gap_)
        node.point = advanced(last, measured, step);
      else
        node.point.run = last.point.run + 1;
    }
    nodes_.push_back(node);
  }

  /// Integrates from `a` towards the next measurement `b`; forces by Simpson's rule with the attitude half-way.
  [[nodiscard]] static TrackPoint advanced(const Node& a, const Measurement& b, double dt) {
    const double share = dt / (b.stamp - a.measured.stamp);
    const Eigen::Vector3d gyro_change = scaled(share, difference_of(b.gyro, a.measured.gyro));
    const Eigen::Vector3d force_change = scaled(share, difference_of(b.accel, a.measured.accel));
    TrackPoint point = a.point;
    const SO3d R_middle = a.point.R * SO3d::exp(scaled(0.5 * dt, sum_of(a.measured.gyro, scaled(0.25, gyro_change))));
    const Eigen::Vector3d coning = scaled(dt * dt / 12, Eigen::Vector3d(a.measured.gyro.cross(gyro_change)));
    const Eigen::Vector3d turn = scaled(dt, sum_of(a.measured.gyro, scaled(0.5, gyro_change)));
    point.R = a.point.R * SO3d::exp(turn + coning);
    const Eigen::Vector3d first = a.point.R * a.measured.accel;
    const Eigen::Vector3d middle = R_middle * sum_of(a.measured.accel, scaled(0.5, force_change));
    const Eigen::Vector3d last = point.R * sum_of(a.measured.accel, force_change);
    const Eigen::Vector3d gained = scaled(dt * dt / 6, sum_of(first, scaled(2, middle)));
    point.force_integral2 = sum_of(point.force_integral2, sum_of(scaled(dt, a.point.force_integral), gained));
    point.force_integral = sum_of(point.force_integral, scaled(dt / 6, sum_of(sum_of(first, scaled(4, middle)), last)));
    point.R_integral = sum_of(point.R_integral, scaled(dt, R_middle.matrix()));
    return point;
  }

  void find(double stamp, std::size_t& hint) const {
    const std::size_t last = nodes_.size() - 2;
    hint = std::min(hint, last);
    for (int steps = 0; steps < 64; ++steps) {
      if (nodes_[hint].measured.stamp > stamp) {
        --hint;
      } else if (hint < last && nodes_[hint + 1].measured.stamp < stamp) {
        ++hint;
      } else {
        return;
      }
    }
    // Of two that meet at the stamp the earlier one, as the steps above find it: the same wherever a search began.
    const auto reached = std::lower_bound(nodes_.begin(), nodes_.end(), stamp,
                                          [](const Node& node, double t) { return node.measured.stamp < t; });
    const auto position = static_cast<std::size_t>(reached - nodes_.begin());
    hint = std::min(position > 0 ? position - 1 : 0, last);
  }

  double max_gap_;
  std::optional<Measurement> newest_;
  std::deque<Node> nodes_;
};

}  // namespace chainslam::detail
