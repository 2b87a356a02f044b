#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/finite.hpp"
#include "chainslam/io/input_file.hpp"
#include "chainslam/io/line_fields.hpp"
#include "chainslam/sensor/point_time.hpp"

namespace chainslam::datasets {

/// A whole number of some unit since 1970. @throws IoError naming line and field if it lies before 1970 or after 2255.
[[nodiscard]] inline Timestamp time_field(LineFields& fields, TimeUnit unit) {
  const std::int64_t value = fields.integer("time");
  const auto nanoseconds = static_cast<std::int64_t>(nanoseconds_per(unit));
  if (value < 0 || value > 9'000'000'000'000'000'000 / nanoseconds)
    fields.fail("time", std::to_string(value), std::string("write ") + unit_name(unit) + " since 1970");
  return Timestamp::from_nanoseconds(value * nanoseconds);
}

/// Rows of numbers behind a time, such as `utime, x, y, z`; lines that are empty or start with '#' are passed over, and
/// so are fields behind those asked for.
class NumberRows {
 public:
  NumberRows(const std::filesystem::path& path, std::size_t fields, TimeUnit unit, char separator = ',')
      : file_(path), unit_(unit), separator_(separator), values_(fields) {}

  /// The time and the fields after it, NaN among them. @throws IoError naming line and field of what is no number.
  std::optional<std::pair<Timestamp, std::span<const double>>> next() {
    while (const auto line = file_.read_line()) {
      const std::string_view text = detail::trimmed(*line);
      if (text.empty() || text.starts_with('#')) continue;
      LineFields fields(file_, text, separator_);
      const Timestamp time = time_field(fields, unit_);
      for (double& value : values_) value = fields.number_or_nan("value");
      return std::pair(time, std::span<const double>(values_));
    }
    return std::nullopt;
  }

 private:
  InputFile file_;
  TimeUnit unit_;
  char separator_;
  std::vector<double> values_;
};

[[nodiscard]] inline bool all_finite(std::span<const double> values) {
  return std::ranges::all_of(values, [](double value) { return is_finite(value); });
}

}  // namespace chainslam::datasets
