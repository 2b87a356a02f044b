#pragma once

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <iterator>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam::datasets {

enum class TimeUnit { seconds, milliseconds, microseconds, nanoseconds };
/// Whether points count from the scan's stamp or state the time of a clock.
enum class PointTimeBase { relative, absolute };
/// Where in the sweep the scan's stamp lies.
enum class StampPlace { start, end, inside };

/// How to read the time field of a driver's points. Found by `infer_point_time`, or written by hand where it is known.
struct PointTimeRule {
  TimeUnit unit = TimeUnit::seconds;             ///< of the numbers
  PointTimeBase base = PointTimeBase::relative;  ///< what they are relative to
  bool counts_back = false;                      ///< positive values lie before the stamp
  double longest_sweep = 0.25;                   ///< seconds; a scan that spans more is reported as implausible
};

/// What is known of the sensor beforehand. What is stated is not inferred.
struct PointTimeHints {
  double shortest_sweep = 0.04;  ///< seconds that a scan's points may span: 5 to 20 Hz with a margin
  double longest_sweep = 0.25;   ///< seconds
  double clock_tolerance = 1.0;  ///< seconds that absolute times may lie from the stamp and still be its clock's
  std::optional<TimeUnit> unit = std::nullopt;       ///< given by the user; empty: inferred
  std::optional<PointTimeBase> base = std::nullopt;  ///< given by the user; empty: inferred
  std::optional<bool> counts_back = std::nullopt;    ///< given by the user; empty: inferred
};

enum class PointTimeStatus {
  inferred,
  absent,     ///< all values alike: a snapshot, or to be rebuilt from the azimuth
  ambiguous,  ///< more than one reading fits
  unusable    ///< no reading fits
};

/// How times of points are to be read, as far as the data show it.
struct PointTimeInference {
  PointTimeStatus status = PointTimeStatus::unusable;  ///< whether the times can be used
  PointTimeRule rule;                                  ///< only if `inferred`
  StampPlace stamp = StampPlace::start;                ///< only if `inferred`
  double sweep = 0;                                    ///< seconds that the points span; only if `inferred`
  Index not_finite = 0;                                ///< values that are no numbers, left out
  std::string sentence;  ///< for the log: what was found, and what to state if it was refused
};

/// Times of a scan's points.
struct PointTimes {
  Timestamp time;                ///< of the first measurement
  Timestamp end;                 ///< of the last measurement
  std::vector<float> offsets{};  ///< seconds from `time`, in [0, end - time]
  Index replaced = 0;            ///< values that were no numbers: they got their predecessor's time
  bool plausible = true;         ///< the scan spans no more than the rule's longest sweep
};

[[nodiscard]] constexpr double nanoseconds_per(TimeUnit unit) {
  constexpr std::array<double, 4> values = {1e9, 1e6, 1e3, 1.0};
  return values[static_cast<std::size_t>(unit)];
}

[[nodiscard]] constexpr const char* unit_name(TimeUnit unit) {
  constexpr std::array<const char*, 4> names = {"s", "ms", "us", "ns"};
  return names[static_cast<std::size_t>(unit)];
}

namespace point_times {

struct ValueRange {
  double low = 0, high = 0;
  std::size_t finite = 0, rising = 0, falling = 0;
};

inline ValueRange value_range(std::span<const double> values) {
  ValueRange range;
  double last = 0;
  for (const double value : values) {
    if (!is_finite(value)) continue;
    if (range.finite == 0) range.low = range.high = value;
    range.low = std::min(range.low, value);
    range.high = std::max(range.high, value);
    if (range.finite > 0) {
      range.rising += value > last;
      range.falling += value < last;
    }
    last = value;
    ++range.finite;
  }
  return range;
}

inline std::string number(double value, int digits = 6) {
  char text[64];
  std::snprintf(text, sizeof text, "%.*g", digits, value);
  return text;
}

/// As short as it can be read back.
inline std::string exact_number(double value) {
  char text[64];
  return {text, std::to_chars(text, std::end(text), value).ptr};
}

/// Units in which the spread of the values is one sweep.
inline std::vector<TimeUnit> fitting_units(double spread, const PointTimeHints& hints) {
  std::vector<TimeUnit> units;
  for (const TimeUnit unit :
       {TimeUnit::seconds, TimeUnit::milliseconds, TimeUnit::microseconds, TimeUnit::nanoseconds}) {
    if (hints.unit && *hints.unit != unit) continue;
    const double sweep = spread * nanoseconds_per(unit) * 1e-9;
    if (sweep >= hints.shortest_sweep && sweep <= hints.longest_sweep) units.push_back(unit);
  }
  return units;
}

/// Where the zero of relative times lies, allowing a tenth of the sweep at either end for what was cut away.
inline StampPlace stamp_place(double first, double last) {
  const double slack = 0.1 * (last - first);
  if (first >= -slack) return StampPlace::start;
  return last <= slack ? StampPlace::end : StampPlace::inside;
}

}  // namespace point_times

/// Finds out what a driver's per-point time field means: unit from its spread, which must be one sweep; base from its
/// distance to zero and to `stamp`; direction from its order. Refuses, with a sentence that says what to state, where
/// more than one reading fits or none.
///
/// @param raw    the field's values in the order of the points, as numbers; those that are not finite are left out.
/// @param stamp  the scan's stamp; nothing if the source states none, and absolute times are then accepted.
[[nodiscard]] inline PointTimeInference infer_point_time(std::span<const double> raw, std::optional<Timestamp> stamp,
                                                         const PointTimeHints& hints = {}) {
  using point_times::number;
  PointTimeInference result;
  const point_times::ValueRange range = point_times::value_range(raw);
  result.not_finite = to_index(raw.size() - range.finite, "points");
  const auto refuse = [&](PointTimeStatus status, const std::string& sentence) {
    result.status = status;
    result.sentence = sentence;
    return result;
  };
  if (range.finite == 0) return refuse(PointTimeStatus::absent, "no point has a time");
  if (range.low == range.high)
    return refuse(PointTimeStatus::absent, "every point has the time " + number(range.low) + ": no time per point");

  const double spread = range.high - range.low;
  const std::string values =
      "values from " + point_times::exact_number(range.low) + " to " + point_times::exact_number(range.high);
  const std::vector<TimeUnit> units = point_times::fitting_units(spread, hints);
  if (units.size() > 1)
    return refuse(PointTimeStatus::ambiguous, values + " are a sweep in more than one unit: state the unit");
  if (units.empty())
    return refuse(PointTimeStatus::unusable, values + " span " + number(spread) + ", which is a sweep of " +
                                                 number(hints.shortest_sweep) + " to " + number(hints.longest_sweep) +
                                                 " s in no unit: state the unit and the sweep's length");
  result.rule.unit = units.front();
  result.rule.longest_sweep = hints.longest_sweep;
  const double to_seconds = nanoseconds_per(result.rule.unit) * 1e-9;
  const double first = range.low * to_seconds, last = range.high * to_seconds;
  result.sweep = spread * to_seconds;

  const bool near_zero = first >= -2 * hints.longest_sweep && last <= 2 * hints.longest_sweep;
  const bool near_stamp = stamp && std::abs(first - stamp->to_seconds()) <= hints.clock_tolerance;
  if (!hints.base && near_zero && near_stamp)
    return refuse(PointTimeStatus::ambiguous,
                  values + " lie near zero, and so does the scan's stamp: state relative or absolute");
  if (!hints.base && !near_zero && stamp && !near_stamp)
    return refuse(PointTimeStatus::ambiguous,
                  values + " " + unit_name(result.rule.unit) + " lie " + number(first - stamp->to_seconds()) +
                      " s from the scan's stamp: another clock; state absolute to follow the points");
  result.rule.base = hints.base.value_or(near_zero ? PointTimeBase::relative : PointTimeBase::absolute);
  if (result.rule.base == PointTimeBase::absolute && std::max(std::abs(first), std::abs(last)) > 9.2e9)
    return refuse(PointTimeStatus::unusable, values + " " + unit_name(result.rule.unit) + " are beyond the year 2261");

  const bool falls = range.falling > 9 * range.rising;
  if (falls && !hints.counts_back && result.rule.base == PointTimeBase::relative && range.low >= 0)
    return refuse(PointTimeStatus::ambiguous,
                  values + " fall from point to point: state whether they count back from the scan's stamp");
  result.rule.counts_back = hints.counts_back.value_or(false);
  const double sign = result.rule.counts_back ? -1 : 1;
  const double origin = result.rule.base == PointTimeBase::relative ? 0 : (stamp ? stamp->to_seconds() : first);
  result.stamp = point_times::stamp_place(std::min(sign * (first - origin), sign * (last - origin)),
                                          std::max(sign * (first - origin), sign * (last - origin)));
  constexpr std::array<const char*, 3> places = {"start", "end", "inside"};
  result.status = PointTimeStatus::inferred;
  result.sentence = std::string("time per point: ") + unit_name(result.rule.unit) +
                    (result.rule.base == PointTimeBase::relative ? ", relative to the scan's stamp" : ", absolute") +
                    (result.rule.counts_back ? ", counting back" : "") + ", stamp at the sweep's " +
                    places[static_cast<std::size_t>(result.stamp)] + ", sweep of " + number(result.sweep, 4) + " s";
  return result;
}

/// Reads a scan's time field by a rule.
///
/// @param stamp  the scan's stamp, from which relative times count.
/// @throws std::invalid_argument if a time lies outside what a `Timestamp` can state.
[[nodiscard]] inline PointTimes apply_point_time(const PointTimeRule& rule, std::span<const double> raw,
                                                 Timestamp stamp) {
  const point_times::ValueRange range = point_times::value_range(raw);
  const bool relative = rule.base == PointTimeBase::relative;
  PointTimes result{.time = stamp, .end = stamp};
  result.offsets.assign(raw.size(), 0.0F);
  result.replaced = to_index(raw.size() - range.finite, "points");
  if (range.finite == 0) return result;

  const double to_nanoseconds = nanoseconds_per(rule.unit) * (relative && rule.counts_back ? -1.0 : 1.0);
  const double origin = to_nanoseconds < 0 ? range.high : range.low;  // raw value of the first measurement
  const double first = origin * to_nanoseconds;
  const double span = (range.high - range.low) * std::abs(to_nanoseconds);
  const double room = 9.2e18 - (relative ? std::abs(static_cast<double>(stamp.nanoseconds())) : 0.0);
  if (std::abs(first) + span > room)
    throw std::invalid_argument(
        "apply_point_time: a point's time lies outside the years 1678 to 2261; is the unit right?");
  const Duration from_base(std::llround(first));
  result.time = relative ? stamp + from_base : Timestamp(from_base);
  result.end = result.time + Duration(std::llround(span));
  result.plausible = span * 1e-9 <= rule.longest_sweep;

  float longest = static_cast<float>(to_seconds(result.end - result.time));
  if (longest > to_seconds(result.end - result.time)) longest = std::nextafter(longest, 0.0F);
  float last = 0;
  for (std::size_t i = 0; i < raw.size(); ++i) {
    if (is_finite(raw[i]))
      last = std::clamp(static_cast<float>((raw[i] - origin) * to_nanoseconds * 1e-9), 0.0F, longest);
    result.offsets[i] = last;
  }
  return result;
}

}  // namespace chainslam::datasets
