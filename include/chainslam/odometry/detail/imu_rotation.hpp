#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <deque>
#include <optional>

#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/so3.hpp"
#include "chainslam/sensor/packet.hpp"

namespace chainslam::detail {

/// Integrates a gyroscope's measurements to rotations between any two times.
///
/// The rate runs linearly between two measurements; each piece is integrated to fourth order in its length (Magnus
/// expansion of R' = R hat(w)), so that 10 Hz units are usable. Before the first and after the last measurement the
/// rate is held, for at most `max_gap`. Over a longer hole there is no answer: the caller falls back to its motion
/// model.
class ImuRotation {
 public:
  /// @param max_gap  longest time without a sample that is integrated across.
  explicit ImuRotation(Duration max_gap = seconds(0.25)) : max_gap_(max_gap) {}

  /// Takes the next measurement. One that goes back in time by more than the longest hole resets the record: either
  /// the clock was set, or the measurements before it were wrong.
  /// @returns false if it was dropped: not finite, or not later than the one before.
  bool add(const ImuSample& sample) {
    if (!is_finite(sample.gyro) || !is_finite(sample.accel)) return false;
    if (!samples_.empty() && samples_.back().time - sample.time > max_gap_) samples_.clear();
    if (!samples_.empty() && sample.time <= samples_.back().time) return false;
    samples_.push_back(sample);
    return true;
  }

  /// Rotation of the body from one time to another, R_from_to, with `bias` (rad/s) taken off the measurements.
  /// @returns nothing if the measurements leave a hole longer than the longest allowed, or if `to` is before `from`.
  [[nodiscard]] std::optional<SO3d> rotation(Timestamp from, Timestamp to, const Eigen::Vector3d& bias) const {
    if (to < from || !covers(from, to)) return std::nullopt;
    SO3d R_from_t;
    Timestamp t = from;
    for (std::size_t next = first_after(from); t < to; ++next) {
      const Timestamp stop = next < samples_.size() ? std::min(samples_[next].time, to) : to;
      R_from_t = R_from_t * step(rate(t, next) - bias, rate(stop, next) - bias, to_seconds(stop - t));
      t = stop;
    }
    return R_from_t;
  }

  /// Forgets measurements that no interval starting at `time` or later needs.
  void forget_before(Timestamp time) {
    while (samples_.size() > 1 && samples_[1].time <= time) samples_.pop_front();
  }

  [[nodiscard]] const std::deque<ImuSample>& samples() const { return samples_; }  ///< samples, in the order of time

 private:
  [[nodiscard]] std::size_t first_after(Timestamp time) const {
    const auto later = std::upper_bound(samples_.begin(), samples_.end(), time,
                                        [](Timestamp t, const ImuSample& sample) { return t < sample.time; });
    return static_cast<std::size_t>(later - samples_.begin());
  }

  [[nodiscard]] bool covers(Timestamp from, Timestamp to) const {
    if (samples_.empty() || samples_.front().time - from > max_gap_ || to - samples_.back().time > max_gap_)
      return false;
    for (std::size_t i = first_after(from); i < samples_.size() && i > 0; ++i) {
      if (samples_[i].time - samples_[i - 1].time > max_gap_ && samples_[i - 1].time < to) return false;
      if (samples_[i].time >= to) break;
    }
    return true;
  }

  /// Rate at `time`, which lies in the piece that ends with sample `next`.
  [[nodiscard]] Eigen::Vector3d rate(Timestamp time, std::size_t next) const {
    if (next == 0) return samples_.front().gyro;
    if (next >= samples_.size()) return samples_.back().gyro;
    const ImuSample& a = samples_[next - 1];
    const ImuSample& b = samples_[next];
    const double share = to_seconds(time - a.time) / to_seconds(b.time - a.time);
    const Eigen::Vector3d change = b.gyro - a.gyro;
    return a.gyro + Eigen::Vector3d(share * change);
  }

  static SO3d step(const Eigen::Vector3d& begin, const Eigen::Vector3d& end, double duration) {
    const Eigen::Vector3d coning = (duration * duration / 12) * Eigen::Vector3d(begin.cross(end));
    const Eigen::Vector3d mean = 0.5 * duration * Eigen::Vector3d(begin + end);
    return SO3d::exp(mean + coning);
  }

  Duration max_gap_;
  std::deque<ImuSample> samples_;
};

}  // namespace chainslam::detail
