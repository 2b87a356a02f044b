#pragma once

#include <chrono>
#include <cmath>
#include <compare>
#include <cstdint>

namespace chainslam {

/// A span of time, in nanoseconds.
using Duration = std::chrono::nanoseconds;

/// Rounds seconds to the nearest nanosecond.
[[nodiscard]] inline Duration seconds(double value) {
  return Duration(static_cast<std::int64_t>(std::llround(value * 1e9)));
}

[[nodiscard]] constexpr double to_seconds(Duration duration) { return static_cast<double>(duration.count()) * 1e-9; }

/// A point in time: nanoseconds since the data set's own epoch. Never a double: at 1.6e9 s a double's step is 0.24 us.
class Timestamp {
 public:
  constexpr Timestamp() = default;
  constexpr explicit Timestamp(Duration since_epoch) : since_epoch_(since_epoch) {}  ///< a time so long after the epoch

  /// From nanoseconds since the epoch.
  [[nodiscard]] static constexpr Timestamp from_nanoseconds(std::int64_t value) { return Timestamp(Duration(value)); }
  /// From microseconds since the epoch.
  [[nodiscard]] static constexpr Timestamp from_microseconds(std::int64_t value) {
    return Timestamp(std::chrono::microseconds(value));
  }
  /// For files that state seconds as a decimal number that was already rounded to a double.
  [[nodiscard]] static Timestamp from_seconds(double value) { return Timestamp(chainslam::seconds(value)); }

  /// Nanoseconds since the epoch.
  [[nodiscard]] constexpr std::int64_t nanoseconds() const { return since_epoch_.count(); }
  /// Seconds since the epoch, rounded to a double: for display.
  [[nodiscard]] constexpr double to_seconds() const { return chainslam::to_seconds(since_epoch_); }

  friend constexpr auto operator<=>(const Timestamp&, const Timestamp&) = default;  ///< orders by value
  /// The time from b to a.
  friend constexpr Duration operator-(Timestamp a, Timestamp b) { return a.since_epoch_ - b.since_epoch_; }
  /// The time d after t.
  friend constexpr Timestamp operator+(Timestamp t, Duration d) { return Timestamp(t.since_epoch_ + d); }
  /// The time d before t.
  friend constexpr Timestamp operator-(Timestamp t, Duration d) { return Timestamp(t.since_epoch_ - d); }

 private:
  Duration since_epoch_{0};
};

/// The latest time that readers take, in nanoseconds since 1970, and the earliest if negative: the years 1824 to 2115.
/// No difference of two such times overflows, nor their sum with what filters add.
inline constexpr std::int64_t latest_nanoseconds = 4'600'000'000'000'000'000;

[[nodiscard]] constexpr bool is_recorded_time(Timestamp time) {
  return time.nanoseconds() >= -latest_nanoseconds && time.nanoseconds() <= latest_nanoseconds;
}

}  // namespace chainslam
