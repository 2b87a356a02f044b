#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <utility>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sensor/detail/interleaved_imu.hpp"
#include "chainslam/sensor/detail/stuck_axes.hpp"
#include "chainslam/sensor/imu_units.hpp"
#include "chainslam/sensor/packet.hpp"

namespace chainslam {

/// What an IMU may measure.
struct ImuCheckOptions {
  std::optional<ImuUnits> units{};  ///< of the samples; inferred from them if absent
  double max_gyro = 100;            ///< rad/s, of an axis; the fastest gyroscopes end at 70
  double max_accel = 1000;          ///< m/s^2; shocks on vehicles and robots stay below 500
  double spike_gyro = 2;            ///< rad/s by which a sample must differ from both its neighbours to be a spike, ...
  double spike_accel = 50;          ///< m/s^2, ...
  double spike_ratio = 20;          ///< ... and times more than the neighbours differ and samples lately have
  Duration backward_jump = std::chrono::milliseconds(250);  ///< a step back in time by more is a clock that was set
  int stuck_samples = 20;                                   ///< for which an axis repeats its value while others change
  Duration stuck_time = std::chrono::milliseconds(100);     ///< and at least as long
};

/// What became of an IMU's samples so far.
struct ImuCheckCounts {
  std::int64_t received = 0;  ///< samples that came
  // Left out:
  std::int64_t not_finite = 0;     ///< with NaN or infinite numbers
  std::int64_t out_of_range = 0;   ///< beyond what any IMU measures
  std::int64_t spikes = 0;         ///< isolated
  std::int64_t repeated = 0;       ///< equal to the row before
  std::int64_t out_of_order = 0;   ///< not later than the one before
  std::int64_t invalid_times = 0;  ///< a time that neither the sample before nor the one after agrees with
  std::int64_t second_imu = 0;     ///< of another IMU, whose rows alternate with those of the first
  // Passed on, but without one of the sensors:
  std::int64_t stuck_gyro = 0;   ///< samples with a stuck axis of the gyroscope
  std::int64_t stuck_accel = 0;  ///< samples with a stuck axis of the accelerometer
  // Passed on, converted:
  std::int64_t from_g = 0;        ///< samples converted from g
  std::int64_t from_degrees = 0;  ///< samples converted from degrees per second

  /// Left out, for whatever reason.
  [[nodiscard]] std::int64_t rejected() const {
    return not_finite + out_of_range + spikes + repeated + out_of_order + invalid_times + second_imu;
  }
};

/// Lets nothing of an IMU's samples through that cannot have been measured: bad numbers, spikes, repeated rows, stuck
/// axes, a second IMU's rows, bad times; converts units. Everything is counted.
///
/// Ordinary samples are passed on at once. A sample that may be a spike, or whose time jumps, waits for the next one,
/// which shows whether it is isolated; no sample waits for more. Shocks and vibration pass: only a single sample is
/// taken for a spike, if it differs from both neighbours by more than a strong shock, and by many times what they
/// differ; a sensor that does so again and again is accepted soon. Costs less than 0.2 us a sample.
class ImuCheck {
 public:
  /// Starts without samples.
  explicit ImuCheck(const ImuCheckOptions& options = {})
      : options_(options),
        stuck_gyro_(options.stuck_samples, options.stuck_time),
        stuck_accel_(options.stuck_samples, options.stuck_time) {}

  /// Takes the next sample and calls `take(const ImuSample&)` for each that is ready: at most two.
  template <class Take>
  void add(const ImuSample& raw, Take&& take) {
    ++counts_.received;
    if (!is_finite(raw.gyro) || !is_finite(raw.accel)) {
      ++counts_.not_finite;
      return;
    }
    if (const auto sample = in_range(raw)) {
      if (interleaved_.add(*sample))
        ++counts_.second_imu;
      else
        in_time(*sample, take);
    }
  }

  [[nodiscard]] const ImuCheckCounts& counts() const { return counts_; }  ///< what became of the samples so far
  /// Units of the samples, as set or as recognized.
  [[nodiscard]] const ImuUnits& units() const { return options_.units ? *options_.units : watch_.units(); }

 private:
  using Distances = std::array<double, 2>;  ///< of rate and force
  static Distances distance(const ImuSample& a, const ImuSample& b) {
    return {difference_of(a.gyro, b.gyro).norm(), difference_of(a.accel, b.accel).norm()};
  }

  static bool same_numbers(const ImuSample& a, const ImuSample& b) {
    for (int i = 0; i < 3; ++i)
      if (a.gyro[i] != b.gyro[i] || a.accel[i] != b.accel[i]) return false;
    return true;
  }

  /// The sample in m/s^2 and rad/s, if these are plausible.
  std::optional<ImuSample> in_range(const ImuSample& raw) {
    constexpr double no_unit = 1e4;  // more is out_of_range in any
    const auto within = [](const ImuSample& sample, double gyro, double accel) {
      for (int i = 0; i < 3; ++i)
        if (std::abs(sample.gyro[i]) > gyro || std::abs(sample.accel[i]) > accel) return false;
      return true;
    };
    if (!options_.units && within(raw, no_unit, no_unit)) watch_.add(raw);
    const ImuSample sample = units().converted(raw);
    if (within(sample, options_.max_gyro, options_.max_accel)) return sample;
    ++counts_.out_of_range;
    return std::nullopt;
  }

  /// Puts the sample in its place after the last: drops it, keeps it back, or passes it on.
  template <class Take>
  void in_time(const ImuSample& sample, Take& take) {
    if (held_) {
      if (same_numbers(sample, *held_) && sample.time - held_->time <= longest_step()) {
        ++counts_.repeated;
        return;
      }
      const ImuSample held = *std::exchange(held_, std::nullopt);
      if (confirmed(held, sample)) pass(held, take);
    }
    const Duration step = last_ ? sample.time - last_->time : Duration(1);
    const bool same = last_ && same_numbers(sample, *last_);
    if (step <= Duration::zero() && step >= -options_.backward_jump) {
      ++(same ? counts_.repeated : counts_.out_of_order);
    } else if (same && repeats(sample.time)) {
      ++counts_.repeated;
    } else if (last_ && (step < Duration::zero() || step > longest_step() || jumps(sample))) {
      held_ = sample;
    } else {
      pass(sample, take);
    }
  }

  template <class Take>
  void pass(ImuSample sample, Take& take) {
    learn(sample);
    sample.rate_measured = sample.rate_measured && !stuck_gyro_.add(sample.gyro, sample.time);
    sample.force_measured = sample.force_measured && !stuck_accel_.add(sample.accel, sample.time);
    if (!sample.rate_measured) ++counts_.stuck_gyro;
    if (!sample.force_measured) ++counts_.stuck_accel;
    if (units().accel == AccelUnit::g) ++counts_.from_g;
    if (units().gyro == GyroUnit::degrees_per_second) ++counts_.from_degrees;
    take(std::as_const(sample));
  }

  /// Whether the sample after it shows that one that was kept back has been measured, and then.
  bool confirmed(const ImuSample& held, const ImuSample& next) {
    const Duration step = held.time - last_->time;
    if (step > Duration::zero() && step <= longest_step()) return !isolated(held, next);
    // A gap, or a clock that was set back, if time runs on from there.
    const bool runs_on = next.time > held.time && (step > Duration::zero() || next.time < last_->time);
    if (!runs_on) ++counts_.invalid_times;
    return runs_on;
  }

  /// Whether a sample could be a spike.
  [[nodiscard]] bool jumps(const ImuSample& sample) const {
    const Distances jump = distance(sample, *last_);
    return jump[0] > 0.9 * options_.spike_gyro || jump[1] > 0.9 * options_.spike_accel;
  }

  /// Whether a sample differs from both its neighbours as only an error does; counts it.
  bool isolated(const ImuSample& sample, const ImuSample& next) {
    if (next.time <= sample.time || next.time - sample.time > longest_step()) return false;
    const Distances off = from_neighbours(*last_, sample, next), across = distance(*last_, next);
    const std::array<double, 2> least{options_.spike_gyro, options_.spike_accel};
    bool spike = false;
    for (std::size_t i = 0; i < 2; ++i)
      spike = spike || (off[i] > least[i] && off[i] > options_.spike_ratio * std::max(across[i], usual_off_[i]));
    if (!spike) return false;
    ++counts_.spikes;
    // What comes again and again is vibration: each time more counts as usual.
    for (std::size_t i = 0; i < 2; ++i)
      usual_off_[i] +=
          (std::min(off[i], options_.spike_ratio * std::max(usual_off_[i], 1e-3)) - usual_off_[i]) / memory;
    return true;
  }

  static Distances from_neighbours(const ImuSample& before, const ImuSample& sample, const ImuSample& after) {
    return {difference_of(sample.gyro, scaled(0.5, sum_of(before.gyro, after.gyro))).norm(),
            difference_of(sample.accel, scaled(0.5, sum_of(before.accel, after.accel))).norm()};
  }

  /// Whether a row equal to the last adds nothing: its numbers were not measured again. Sensors of constant numbers
  /// (without noise, of coarse resolution) pass on one each tenth of a second. One whose rows have always changed, and
  /// now do not for long, has stopped to measure.
  bool repeats(Timestamp time) {
    constexpr Duration most = std::chrono::milliseconds(100), seen = std::chrono::seconds(1);
    const bool stopped = longest_pause_ < most / 2 && changed_ - first_ > seen;
    pause_ = stopped ? Duration::zero() : time - changed_;
    return stopped || time - last_->time < most;
  }

  void learn(const ImuSample& sample) {
    if (!last_) first_ = changed_ = sample.time;
    if (last_ && before_last_) {
      const Distances off = from_neighbours(*before_last_, *last_, sample);
      for (std::size_t i = 0; i < 2; ++i) usual_off_[i] += (off[i] - usual_off_[i]) / memory;
    }
    if (last_) {
      const Duration step = sample.time - last_->time;
      if (step > Duration::zero()) usual_step_ += (std::min(step, 4 * usual_step_) - usual_step_) / 16;
      if (!same_numbers(sample, *last_)) {
        longest_pause_ = std::max(longest_pause_, std::exchange(pause_, Duration::zero()));
        changed_ = sample.time;
      }
    }
    before_last_ = last_;
    last_ = sample;
  }

  /// Between samples, for them to be one stretch.
  [[nodiscard]] Duration longest_step() const { return 4 * usual_step_; }

  static constexpr double memory = 32;  ///< samples

  ImuCheckOptions options_;
  ImuCheckCounts counts_;
  ImuUnitWatch watch_;
  detail::InterleavedImu interleaved_;
  detail::StuckAxes stuck_gyro_, stuck_accel_;
  std::optional<ImuSample> last_, before_last_;  ///< passed on
  std::optional<ImuSample> held_;                ///< waits for the next
  Distances usual_off_{};                        ///< from the neighbours' mean, of samples that were passed on
  Duration usual_step_ = std::chrono::milliseconds(100);
  Timestamp first_, changed_;           ///< of the first sample, and of the last that differed from the one before
  Duration pause_{}, longest_pause_{};  ///< in which samples repeat one another: now, and at most
};

}  // namespace chainslam
