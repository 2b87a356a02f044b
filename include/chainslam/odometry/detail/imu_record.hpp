#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <limits>
#include <memory>
#include <optional>
#include <type_traits>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/odometry/imu_alignment.hpp"
#include "chainslam/odometry/imu_process.hpp"
#include "chainslam/odometry/inertial_motion_options.hpp"
#include "chainslam/sensor/packet.hpp"

namespace chainslam::detail {

/// Mean measurements of a short time; none in a hole.
struct ImuStep {
  double duration;                  ///< seconds
  std::optional<ImuInput> reading;  ///< what drives the state over the step; none where nothing was measured
};

/// What an IMU has said lately, as steps to integrate over.
///
/// Measurements run linearly from sample to sample; before the first and after the last they are held for up to
/// `max_gap`. A measurement at the end of its range is known to be wrong, but not by how much: its step's noise says
/// so. Steps next to a sample with a stuck axis are without that sensor: `ImuInput::rate_measured`, `force_measured`.
class ImuRecord {
 public:
  /// What became of a sample.
  enum class Taken {
    yes,
    restarted,  ///< taken, after a jump back in time: those before are forgotten
    dropped,    ///< not finite, or not later than the one before
  };

  explicit ImuRecord(const ImuRecordOptions& options = {}) : options_(options) {}  ///< an empty record

  /// Takes a sample, which is corrected.
  Taken add(const ImuSample& as_measured) {
    const ImuSample sample = correction_(as_measured);
    if (!is_finite(sample.gyro) || !is_finite(sample.accel)) return Taken::dropped;
    Taken taken = Taken::yes;
    if (!samples_.empty() && to_seconds(samples_.back().time - sample.time) > options_.max_gap) {
      samples_.clear();
      taken = Taken::restarted;
    }
    if (!samples_.empty() && sample.time <= samples_.back().time) return Taken::dropped;
    samples_.push_back(sample);
    if (clipped(sample)) ++clipped_;
    return taken;
  }

  /// Corrects samples from now on, and those that are kept.
  void correct(const ImuCorrection& correction) {
    const ImuCorrection change = correction.since(correction_);
    for (ImuSample& sample : samples_) sample = change(sample);
    correction_ = correction;
  }
  [[nodiscard]] const ImuCorrection& correction() const { return correction_; }  ///< how samples are corrected

  /// Calls `step(const ImuStep&)` for all of [from, to] in order.
  template <class Step>
  void for_each_step(Timestamp from, Timestamp to, Step&& step) const {
    using Callable = std::remove_reference_t<Step>;
    walk(from, to,
         {const_cast<void*>(static_cast<const void*>(std::addressof(step))),
          [](void* callable, const ImuStep& piece) { (*static_cast<Callable*>(callable))(piece); }});
  }

  /// Forgets measurements that nothing from `time` on needs.
  void forget_before(Timestamp time) {
    while (samples_.size() > 1 && samples_[1].time <= time) samples_.pop_front();
  }
  /// Drops samples that are not needed any more.
  void forget_old() {
    if (!samples_.empty()) forget_before(samples_.back().time - seconds(options_.memory));
  }

  /// Whether measurements reach up to `time`, ...
  [[nodiscard]] bool reaches(Timestamp time) const { return !samples_.empty() && samples_.back().time >= time; }
  /// ... or the next one, which would, is to be expected.
  [[nodiscard]] bool may_reach(Timestamp time) const {
    return !samples_.empty() && to_seconds(time - samples_.back().time) <= options_.max_gap;
  }

  /// Corrected samples, in the order of time.
  [[nodiscard]] const std::deque<ImuSample>& samples() const { return samples_; }
  [[nodiscard]] std::int64_t clipped_samples() const { return clipped_; }  ///< samples at the end of their range

 private:
  /// What is called for a step, whatever its type: so the walk over the samples is compiled once.
  struct StepCall {
    void* callable;
    void (*call)(void* callable, const ImuStep& piece);
    void operator()(const ImuStep& piece) const { call(callable, piece); }
  };
  void walk(Timestamp from, Timestamp to, StepCall step) const {
    const auto later = std::upper_bound(samples_.begin(), samples_.end(), from,
                                        [](Timestamp t, const ImuSample& sample) { return t < sample.time; });
    auto next = static_cast<std::size_t>(later - samples_.begin());
    for (Timestamp t = from; t < to; ++next) {
      const Timestamp end = next < samples_.size() ? std::min(samples_[next].time, to) : to;
      if (end > t) cut(t, end, next, step);
      t = end;
    }
  }
  [[nodiscard]] bool clipped(const ImuSample& sample) const {
    return reaches(sample.gyro, options_.gyro_range) || reaches(sample.accel, options_.accel_range);
  }
  /// Whether any axis reads `range` or more.
  [[nodiscard]] static bool reaches(const Eigen::Vector3d& reading, double range) {
    for (int i = 0; i < 3; ++i)
      if (std::abs(reading[i]) >= range) return true;
    return false;
  }

  /// What a line between two measurements leaves out, as a density: its mean over `interval` may be off by a part of
  /// the difference. Slow units see vibration at random phases, fast ones follow it.
  [[nodiscard]] double unseen(const Eigen::Vector3d& difference, double interval) const {
    return options_.unseen_share * difference.norm() * std::sqrt(interval);
  }

  /// Steps without a measurement. A clock that jumps leaves a hole of any length: behind so many steps that a motion
  /// could be continued over, the rest of it is one.
  template <class Step>
  void pass_hole(double duration, double pieces, Step& step) const {
    constexpr double most_pieces = 1000;
    const double dt = pieces > most_pieces ? options_.max_step : duration / pieces;
    const double count = std::min(pieces, most_pieces);
    for (double k = 0; k < count; ++k) step(ImuStep{dt, std::nullopt});
    if (pieces > most_pieces) step(ImuStep{duration - most_pieces * dt, std::nullopt});
  }

  /// The piece [begin, end] before sample `next`.
  void cut(Timestamp begin, Timestamp end, std::size_t next, StepCall step) const {
    const double duration = to_seconds(end - begin);
    const ImuSample* a = next > 0 ? &samples_[next - 1] : nullptr;
    const ImuSample* b = next < samples_.size() ? &samples_[next] : nullptr;
    const double hole = a != nullptr && b != nullptr ? to_seconds(b->time - a->time)
                        : a != nullptr               ? to_seconds(end - a->time)
                        : b != nullptr               ? to_seconds(b->time - begin)
                                                     : options_.max_gap + 1;
    const double pieces = std::max(1.0, std::ceil(duration / options_.max_step - 1e-6));
    const double dt = duration / pieces;
    if (hole > options_.max_gap) {
      pass_hole(duration, pieces, step);
      return;
    }
    const ImuSample& first = a != nullptr ? *a : *b;
    const ImuSample& last = b != nullptr ? *b : *a;
    ImuInput input;
    if (a != nullptr && b != nullptr) {
      input.gyro_noise = unseen(difference_of(b->gyro, a->gyro), hole);
      input.accel_noise = unseen(difference_of(b->accel, a->accel), hole);
    }
    input.rate_measured = first.rate_measured && last.rate_measured;
    input.force_measured = first.force_measured && last.force_measured;
    if (clipped(first) || clipped(last)) {
      input.gyro_noise += options_.clipped_gyro_noise;
      input.accel_noise += options_.clipped_accel_noise;
    }
    for (double k = 0; k < pieces; ++k) {
      const double share = a != nullptr && b != nullptr ? (to_seconds(begin - a->time) + (k + 0.5) * dt) / hole : 0.0;
      input.gyro = sum_of(first.gyro, scaled(share, difference_of(last.gyro, first.gyro)));
      input.accel = sum_of(first.accel, scaled(share, difference_of(last.accel, first.accel)));
      step(ImuStep{dt, input});
    }
  }

  ImuRecordOptions options_;
  ImuCorrection correction_;
  std::deque<ImuSample> samples_;
  std::int64_t clipped_ = 0;
};

}  // namespace chainslam::detail
