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

#include "chainslam/core/error.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/io/input_file.hpp"
#include "datasets/point_time.hpp"

namespace chainslam::datasets {

/// A whole number of some unit since 1970. @throws IoError naming line and field if it lies before 1970 or after 2115.
[[nodiscard]] inline Timestamp time_field(LineFields& fields, TimeUnit unit) {
  const std::int64_t value = fields.integer("time");
  const auto nanoseconds = static_cast<std::int64_t>(nanoseconds_per(unit));
  if (value < 0 || value > latest_nanoseconds / nanoseconds)
    fields.fail("time", std::to_string(value), std::string("write ") + unit_name(unit) + " since 1970");
  return Timestamp::from_nanoseconds(value * nanoseconds);
}

/// What is said of a last line that was cut short.
[[nodiscard]] inline std::string cut_line(const InputFile& file, const IoError& error) {
  return file.path().filename().string() + ", " + error.report().place + ", byte " + std::to_string(file.offset()) +
         ": the file ends within a line; it was cut short, and what comes before is used";
}

/// Rows of numbers behind a time, such as `utime, x, y, z`; lines that are empty or start with '#' are passed over.
///
/// A damaged last line that has no line end was cut short with its file: the rows end before it, and `cut` says so.
class NumberRows {
 public:
  /// @param fields  numbers behind the time. @param layout  if given, how a row looks that holds no more than these, as
  ///   messages write it: decimal commas, which make more fields of a row, are then refused.
  NumberRows(const std::filesystem::path& path, std::size_t fields, TimeUnit unit, const char* layout = nullptr)
      : file_(path), unit_(unit), layout_(layout), values_(fields) {}

  /// The time and the fields after it, NaN among them. @throws IoError naming line and field of what is no number.
  std::optional<std::pair<Timestamp, std::span<const double>>> next() {
    while (const auto line = file_.read_line()) {
      const std::string_view text = detail::trimmed(*line);
      if (text.empty() || text.starts_with('#')) continue;
      try {
        const Timestamp time = read(text);
        return std::pair(time, std::span<const double>(values_));
      } catch (const IoError& error) {
        if (file_.line_ended()) throw;
        cut_ = cut_line(file_, error);
      }
    }
    return std::nullopt;
  }

  [[nodiscard]] const std::string& cut() const { return cut_; }  ///< a sentence; empty if nothing was

 private:
  Timestamp read(std::string_view text) {
    LineFields fields(file_, text, ',');
    const Timestamp time = time_field(fields, unit_);
    for (double& value : values_) value = fields.number_or_nan("value");
    if (layout_ != nullptr) fields.end(layout_);
    return time;
  }

  InputFile file_;
  TimeUnit unit_;
  const char* layout_;
  std::vector<double> values_;
  std::string cut_;
};

[[nodiscard]] inline bool all_finite(std::span<const double> values) {
  return std::ranges::all_of(values, [](double value) { return is_finite(value); });
}

}  // namespace chainslam::datasets
