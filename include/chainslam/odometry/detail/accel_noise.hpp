#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <deque>
#include <optional>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/odometry/detail/imu_monitor.hpp"
#include "chainslam/odometry/inertial_motion_options.hpp"

namespace chainslam::detail {

/// Estimates the noise density of an accelerometer from how it differs from the scans' motion: vibration that is
/// aliased, errors of scale and attitude, of a clock, included.
///
/// Second differences of the scans' positions are mean accelerations over two `half_span`, which the specific force,
/// turned by the attitude, has to show as well. Half the mean squared change of their difference from one span to the
/// next is the Allan variance at that time (IEEE Std 952-1997, annex C), here of triangular means: gravity and bias
/// cancel. Registration to 2 or 3 mm counts as a density of 0.03 over half a second, of 0.02 over a second. Scans
/// more than a second apart show nothing of it.
class AccelNoise {
 public:
  /// Starts without knowledge.
  explicit AccelNoise(const AccelNoiseOptions& options = {}) : options_(options) { restart(); }

  /// m/s^2 per sqrt(Hz); 0 if it is not estimated.
  [[nodiscard]] double density() const { return std::sqrt(sum_ / time_); }

  /// What adds to a noise of density `own`, which is assumed anyway, so that both give this.
  [[nodiscard]] double excess_over(double own) const { return std::sqrt(std::max(0.0, sum_ / time_ - own * own)); }

  /// Takes what was measured on the way to a scan. @param position  of the body at the scan, by the scan alone, odom.
  /// @param time_error  metres along the body's way: deviation of what the scan's time may be off, odom.
  void follow(const ImuComparison& comparison, const Eigen::Vector3d& position,
              const Eigen::Vector3d& time_error = zeros<Eigen::Vector3d>());

  /// Share of the variance of a scan's position along the way that is the clock's, not registration's.
  /// @param way_off  metres: deviation by its time.
  [[nodiscard]] static double by_time_error(double way_off) {
    constexpr double registration = 0.01;  // metres
    return way_off * way_off / (way_off * way_off + registration * registration);
  }

  /// The next measurements have nothing to do with those before.
  void interrupt() {
    knots_.clear();
    means_.clear();
  }
  /// Forgets everything.
  void restart() {
    interrupt();
    time_ = options_.start_time;
    sum_ = time_ * options_.start * options_.start;
  }

 private:
  struct Knot {
    double time;
    Eigen::Vector3d off;  ///< metres: where the scan puts the body less where forces alone would have carried it
  };
  /// Mean acceleration that the scans show beside the forces, triangular over [begin, end].
  struct Mean {
    double begin, end;
    Eigen::Vector3d value;  ///< m/s^2
    /// Variance by a noise of density 1.
    [[nodiscard]] double unit_variance() const { return 4 / (3 * (end - begin)); }
  };

  /// Of the axes; that along which positions are off counts as little as it then shows of the force.
  [[nodiscard]] static double mean_square(const Eigen::Vector3d& value, const Eigen::Vector3d& time_error) {
    const double squared_error = time_error.squaredNorm(), along = value.dot(time_error);
    const double left_out = by_time_error(std::sqrt(squared_error));
    return (value.squaredNorm() - (left_out > 0 ? left_out * along * along / squared_error : 0.0)) / (3 - left_out);
  }
  void integrate(const ImuComparison& comparison, const Eigen::Vector3d& position);
  /// The latest of some knots that is `half_span` and at most two of them before `time`.
  [[nodiscard]] const Knot* before(double time) const {
    const Knot* found = nullptr;
    for (const Knot& knot : knots_)
      if (knot.time <= time - options_.half_span + tolerance) found = &knot;
    return found != nullptr && found->time >= time - 2 * options_.half_span ? found : nullptr;
  }
  [[nodiscard]] std::optional<Mean> newest_mean() const;

  static constexpr double tolerance = 0.01;  // seconds: scans come evenly, but not quite

  AccelNoiseOptions options_;
  std::deque<Knot> knots_;
  std::deque<Mean> means_;
  Eigen::Vector3d velocity_ = zeros<Eigen::Vector3d>(), position_ = zeros<Eigen::Vector3d>();  ///< by forces alone
  Eigen::Vector3d gravity_ = zeros<Eigen::Vector3d>();  ///< m/s^2, about: keeps these two small
  double sum_ = 0, time_ = 1;                           ///< of squared densities over seconds, and of seconds
};

inline void AccelNoise::follow(const ImuComparison& comparison, const Eigen::Vector3d& position,
                               const Eigen::Vector3d& time_error) {
  if (!(options_.start > 0)) return;
  if (!(comparison.interval > 0) || !comparison.force_measured) return interrupt();
  integrate(comparison, position);
  const std::optional<Mean> mean = newest_mean();
  if (!mean) return;
  const Mean* last = nullptr;
  for (const Mean& other : means_)
    if (other.end <= mean->begin + tolerance) last = &other;
  if (last != nullptr) {
    const double squared = mean_square(difference_of(mean->value, last->value), time_error);
    const double sample = squared / (mean->unit_variance() + last->unit_variance());
    const double kept = std::exp(-comparison.interval / options_.memory);
    sum_ = kept * sum_ + comparison.interval * std::min(sample, options_.largest * options_.largest);
    time_ = kept * time_ + comparison.interval;
  }
  means_.push_back(*mean);
  const double oldest = mean->end - 8 * options_.half_span;
  while (means_.front().end < oldest) means_.pop_front();
  while (knots_.front().time < oldest) knots_.pop_front();
}

inline void AccelNoise::integrate(const ImuComparison& comparison, const Eigen::Vector3d& position) {
  const double dt = comparison.interval;
  if (knots_.empty()) {
    gravity_ = comparison.up;
    velocity_ = position_ = zeros<Eigen::Vector3d>();
    knots_.push_back({0, position});  // the way to it counts for nothing
    return;
  }
  const Eigen::Vector3d way = difference_of(comparison.force_way, scaled(0.5 * dt * dt, gravity_));
  position_ = sum_of(position_, sum_of(scaled(dt, velocity_), way));
  velocity_ = sum_of(velocity_, scaled(dt, difference_of(comparison.force, gravity_)));
  knots_.push_back({knots_.back().time + dt, difference_of(position, position_)});
}

inline std::optional<AccelNoise::Mean> AccelNoise::newest_mean() const {
  const Knot& last = knots_.back();
  const Knot* middle = before(last.time);
  const Knot* first = middle != nullptr ? before(middle->time) : nullptr;
  if (first == nullptr) return std::nullopt;
  const Eigen::Vector3d later = divided(difference_of(last.off, middle->off), last.time - middle->time);
  const Eigen::Vector3d earlier = divided(difference_of(middle->off, first->off), middle->time - first->time);
  const double half = 0.5 * (last.time - first->time);
  return Mean{first->time, last.time, divided(difference_of(later, earlier), half)};
}

}  // namespace chainslam::detail
