#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>

#include "chainslam/core/timestamp.hpp"

namespace chainslam::detail {

/// Tells that an axis of a sensor repeats exactly the same value while both other axes change.
class StuckAxes {
 public:
  /// @param samples, duration  both of which an axis must have kept its value for, to count as stuck.
  StuckAxes(int samples, Duration duration) : samples_(samples), duration_(duration) {}

  /// Takes the next measurement. @returns whether any axis is stuck.
  bool add(const Eigen::Vector3d& value, Timestamp time) {
    ++taken_;
    for (std::size_t i = 0; i < 3; ++i)
      if (taken_ == 1 || value[static_cast<Eigen::Index>(i)] != last_[static_cast<Eigen::Index>(i)]) ++changes_[i];
    bool stuck = false;
    for (std::size_t i = 0; i < 3; ++i) {
      Axis& axis = axes_[i];
      if (taken_ == 1 || value[static_cast<Eigen::Index>(i)] != last_[static_cast<Eigen::Index>(i)])
        axis = {taken_, time, changes_};
      const std::int64_t kept = taken_ - axis.taken;
      bool others_change = true;
      for (std::size_t j = 0; j < 3; ++j)
        if (j != i) others_change = others_change && 4 * (changes_[j] - axis.changes[j]) >= 3 * kept;
      stuck = stuck || (kept >= samples_ && time - axis.time >= duration_ && others_change);
    }
    last_ = value;
    return stuck;
  }

 private:
  using Counts = std::array<std::int64_t, 3>;
  /// When an axis took its present value.
  struct Axis {
    std::int64_t taken = 0;
    Timestamp time;
    Counts changes{};  ///< of all axes until then
  };

  int samples_;
  Duration duration_;
  Eigen::Vector3d last_ = Eigen::Vector3d::Zero();
  std::array<Axis, 3> axes_;
  Counts changes_{};
  std::int64_t taken_ = 0;
};

}  // namespace chainslam::detail
