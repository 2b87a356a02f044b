#pragma once

#include <array>
#include <bit>
#include <charconv>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <system_error>

#include "chainslam/core/timestamp.hpp"
#include "chainslam/io/file_system.hpp"
#include "chainslam/io/input_file.hpp"

namespace chainslam::detail {

inline constexpr std::string_view blanks = " \t";

/// Text without blanks at its ends.
inline std::string_view trimmed(std::string_view text) {
  const std::size_t first = text.find_first_not_of(blanks);
  if (first == std::string_view::npos) return {};
  return text.substr(first, text.find_last_not_of(blanks) - first + 1);
}

/// Whether a number is neither NaN nor infinite, told by its bits: `std::isfinite` is always true under -ffast-math.
inline bool is_finite(double value) {
  return (std::bit_cast<std::uint64_t>(value) & 0x7FF0'0000'0000'0000) != 0x7FF0'0000'0000'0000;
}

/// Drops a plus sign before a digit or a point, which `std::from_chars` does not know.
inline std::string_view without_plus(std::string_view text) {
  return text.size() > 1 && text[0] == '+' && text[1] != '-' ? text.substr(1) : text;
}

/// A number in decimal notation with a point, whatever the locale; "nan" and "inf" are numbers. Too small is 0.
inline std::optional<double> parse_double(std::string_view text) {
  text = without_plus(text);
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (end != text.data() + text.size() || text.empty()) return std::nullopt;
  if (error == std::errc::result_out_of_range)
    return text.find("e-") != text.npos || text.find("E-") != text.npos ? std::optional(0.0) : std::nullopt;
  return error == std::errc() ? std::optional(value) : std::nullopt;
}

/// A whole number in decimal notation.
inline std::optional<std::int64_t> parse_integer(std::string_view text) {
  text = without_plus(text);
  std::int64_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (end != text.data() + text.size() || error != std::errc()) return std::nullopt;
  return value;
}

/// Decimal seconds ("1403715524.907143168", "1.3050317e+09") as nanoseconds, digit by digit: no double comes between.
/// Digits beyond the ninth are rounded, half away from zero. Nothing if it is no number or beyond 292 years.
inline std::optional<std::int64_t> parse_seconds(std::string_view text) {
  const bool negative = text.starts_with('-');
  if (negative || text.starts_with('+')) text.remove_prefix(1);
  std::int64_t exponent = 0;
  if (const std::size_t e = text.find_first_of("eE"); e != text.npos) {
    const auto parsed = parse_integer(text.substr(e + 1));
    if (!parsed || *parsed < -400 || *parsed > 400) return std::nullopt;
    exponent = *parsed;
    text = text.substr(0, e);
  }
  std::string digits;
  std::optional<std::size_t> point;
  for (const char c : text) {
    if (c == '.' && !point)
      point = digits.size();
    else if (c >= '0' && c <= '9')
      digits += c;
    else
      return std::nullopt;
  }
  if (digits.empty()) return std::nullopt;
  const std::int64_t whole = static_cast<std::int64_t>(point.value_or(digits.size())) + exponent + 9;
  const auto digit = [&](std::int64_t i) {
    return i >= 0 && i < static_cast<std::int64_t>(digits.size()) ? digits[static_cast<std::size_t>(i)] - '0' : 0;
  };
  std::int64_t value = 0;
  for (std::int64_t i = 0; i < whole; ++i)
    if (__builtin_mul_overflow(value, 10, &value) || __builtin_add_overflow(value, digit(i), &value))
      return std::nullopt;
  if (whole >= 0 && digit(whole) >= 5 && __builtin_add_overflow(value, 1, &value)) return std::nullopt;
  return negative ? -value : value;
}

/// Appends the shortest decimal that reads back as the same number.
template <class Number>
void append_number(std::string& text, Number value) {
  std::array<char, 32> digits{};
  text.append(digits.data(), std::to_chars(digits.data(), digits.data() + digits.size(), value).ptr);
}

/// Appends seconds with nine decimals, exactly.
inline void append_seconds(std::string& text, Timestamp time) {
  const std::int64_t value = time.nanoseconds();
  const std::uint64_t magnitude = value < 0 ? 0 - static_cast<std::uint64_t>(value) : static_cast<std::uint64_t>(value);
  if (value < 0) text += '-';
  append_number(text, magnitude / 1'000'000'000);
  const std::string fraction = std::to_string(magnitude % 1'000'000'000);
  text += '.';
  text.append(9 - fraction.size(), '0');
  text += fraction;
}

/// Says what is wrong with a field that should have been a number, and what would help.
inline std::string number_remedy(std::string_view field, const char* wanted) {
  if (field.find(',') != field.npos)
    return "write decimals with a point and separate fields as the format asks: a comma is read as part of the number";
  return std::string("write ") + wanted + " here";
}

/// At most 40 characters of a field, fit for a message.
inline std::string shown(std::string_view field) {
  std::string text = "'";
  for (const char c : field.substr(0, 40)) text += c >= ' ' && c != '\x7F' ? c : '?';
  return text + (field.size() > 40 ? "...'" : "'");
}

/// The fields of one line, read from left to right. Errors name the line and the field.
class LineFields {
 public:
  /// @param separator  ',' for CSV (blanks around fields are dropped), or ' ' for any run of blanks.
  LineFields(const InputFile& file, std::string_view line, char separator = ' ')
      : file_(&file), rest_(separator == ' ' ? trimmed(line) : line), separator_(separator), left_(!rest_.empty()) {}

  [[nodiscard]] bool more() const { return left_; }

  /// The next field's text. @throws IoError if the line has no more.
  std::string_view text(const char* name) {
    if (!left_) fail(name, "the end of the line", "check that the line holds all its fields");
    const std::size_t end = separator_ == ' ' ? rest_.find_first_of(blanks) : rest_.find(separator_);
    const std::string_view field = trimmed(rest_.substr(0, end));
    left_ = end != std::string_view::npos;
    if (left_) rest_ = separator_ == ' ' ? trimmed(rest_.substr(end)) : rest_.substr(end + 1);
    return field;
  }

  /// Any number, NaN and infinity among them.
  double number_or_nan(const char* name) {
    const std::string_view field = text(name);
    const auto value = parse_double(field);
    if (!value) fail(name, shown(field), number_remedy(field, "a number"));
    return *value;
  }

  double number(const char* name) {
    const std::string_view field = text(name);
    const auto value = parse_double(field);
    if (!value || !is_finite(*value)) fail(name, shown(field), number_remedy(field, "a finite number"));
    return *value;
  }

  std::int64_t integer(const char* name) {
    const std::string_view field = text(name);
    const auto value = parse_integer(field);
    if (!value) fail(name, shown(field), number_remedy(field, "a whole number"));
    return *value;
  }

  Timestamp time_in_seconds(const char* name) {
    const std::string_view field = text(name);
    const auto value = parse_seconds(field);
    if (value) return Timestamp::from_nanoseconds(*value);
    const bool huge = parse_double(field).value_or(0) > 9e9;
    fail(name, shown(field),
         huge ? "write the time in seconds; this looks like nanoseconds or microseconds"
              : number_remedy(field, "the time in seconds"));
  }

  /// @throws IoError if fields are left.
  void end(const char* layout) {
    if (left_) fail("after the last", shown(trimmed(rest_)), std::string("each line holds ") + layout);
  }

  [[noreturn]] void fail(const char* name, std::string found, std::string remedy) const {
    file_->fail(file_->place_of_line() + ", field " + name, std::move(found), std::move(remedy));
  }

 private:
  const InputFile* file_;
  std::string_view rest_;
  char separator_;
  bool left_;
};

}  // namespace chainslam::detail
