#pragma once

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <cstddef>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/sensor/packet.hpp"

namespace chainslam::detail {

/// Tells the rows of a second IMU that alternate with those of the first.
///
/// Rows of one IMU are nearer to the row before than to the one before that, or, of pure noise, as near. Where steps
/// to the last row but one are a third of those to the last, over a third of a hundred rows, there are two IMUs. (On
/// nine real recordings the squares were never more than 1.7 apart.) The first row's IMU is kept, unless the other's
/// acceleration is nearer to gravity. Two IMUs that measure the same cannot be told apart, and need not be.
class InterleavedImu {
 public:
  /// Takes the next row. @returns whether it is of the IMU that is not used.
  bool add(const ImuSample& row) {
    if (rows_++ >= 2) compare(row);
    const std::size_t track = (rows_ + slip_) % 2;
    const bool other = found_ && follow(row, track) != kept_;
    before_last_ = last_;
    last_ = row;
    return other;
  }

 private:
  static constexpr double memory = 32, forget_after = 1000;     ///< rows
  static constexpr double clear = 9, unclear = 2;               ///< ratios of squares
  static constexpr double rate_noise = 0.1, force_noise = 1.0;  ///< rad/s, m/s^2: less is harmless
  using Squares = std::array<double, 2>;                        ///< of rate and force, in units of that noise

  static Squares distance(const ImuSample& a, const ImuSample& b) {
    return {difference_of(a.gyro, b.gyro).squaredNorm() / (rate_noise * rate_noise),
            difference_of(a.accel, b.accel).squaredNorm() / (force_noise * force_noise)};
  }

  void compare(const ImuSample& row) {
    const Squares one = distance(row, last_), two = distance(row, before_last_);
    bool alternates = false, apart = false;
    for (std::size_t i = 0; i < 2; ++i) {
      one_step_[i] += (one[i] - one_step_[i]) / memory;
      two_steps_[i] += (two[i] - two_steps_[i]) / memory;
      alternates = alternates || (one_step_[i] > 1 && one_step_[i] > clear * two_steps_[i]);
      apart = apart || (one_step_[i] > 1 && one_step_[i] > unclear * two_steps_[i]);
    }
    together_ = apart ? 0 : together_ + 1;
    if (!found_ && alternates && static_cast<double>(rows_) > memory) begin(row);
    if (together_ > forget_after) found_ = false;
  }

  /// Two IMUs, of which `row` and the one before are the first to be told apart.
  void begin(const ImuSample& row) {
    constexpr double gravity = 9.81;
    found_ = true;
    slip_ = 0;
    const std::size_t track = rows_ % 2;
    tracks_[track] = row;
    tracks_[1 - track] = last_;
    kept_ = 1;  // of the first row
    const auto off = [&](std::size_t i) { return std::abs(tracks_[i].accel.norm() - gravity); };
    if (off(1) > off(0) + 3 * force_noise) kept_ = 0;
  }

  /// @returns the IMU that a row is of: the one whose turn it is, unless a row is missing.
  std::size_t follow(const ImuSample& row, std::size_t track) {
    const Squares expected = distance(row, tracks_[track]), other = distance(row, tracks_[1 - track]);
    if (expected[0] + expected[1] > 1 && expected[0] + expected[1] > clear * (other[0] + other[1])) {
      slip_ = 1 - slip_;
      track = 1 - track;
    }
    tracks_[track] = row;
    return track;
  }

  std::size_t rows_ = 0, slip_ = 0, kept_ = 1;
  ImuSample last_, before_last_;
  Squares one_step_{}, two_steps_{};  ///< mean squared distances to the last row and the one before
  double together_ = 0;               ///< rows since the two differed
  bool found_ = false;
  std::array<ImuSample, 2> tracks_;
};

}  // namespace chainslam::detail
