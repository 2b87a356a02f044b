#pragma once

#include <array>
#include <charconv>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <system_error>

#include "chainslam/core/error.hpp"
#include "chainslam/core/timestamp.hpp"

namespace chainslam::detail {

inline constexpr std::string_view blanks = " \t";

/// Text without blanks at its ends.
inline std::string_view trimmed(std::string_view text) {
  const std::size_t first = text.find_first_not_of(blanks);
  if (first == std::string_view::npos) return {};
  return text.substr(first, text.find_last_not_of(blanks) - first + 1);
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
/// Digits beyond the ninth are rounded, half away from zero. Nothing if it is no number or no `is_recorded_time`.
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
  if (value > latest_nanoseconds) return std::nullopt;
  return negative ? -value : value;
}

/// Appends the shortest decimal that reads back as the same number.
template <class Number>
void append_number(std::string& text, Number value) {
  std::array<char, 32> digits{};
  text.append(digits.data(), std::to_chars(digits.data(), digits.data() + digits.size(), value).ptr);
}

/// Appends a number with so many significant digits, as "%.6g" does with six, whatever the locale.
inline void append_number(std::string& text, double value, int digits) {
  std::array<char, 64> written{};
  const auto end = written.data() + written.size();
  text.append(written.data(), std::to_chars(written.data(), end, value, std::chars_format::general, digits).ptr);
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
  std::string remedy = "write ";
  remedy += wanted;
  remedy += " here";
  return remedy;
}

/// As `number_remedy`, for a time in seconds.
inline std::string time_remedy(std::string_view field) {
  if (parse_double(field).value_or(0) > 4.6e9)
    return "write the time in seconds; this looks like nanoseconds or microseconds";
  return number_remedy(field, "the time in seconds");
}

/// At most 40 bytes of a field, fit for a message.
inline std::string shown(std::string_view field) {
  std::size_t end = 40;  // not within a character of several bytes
  while (end < field.size() && end > 36 && (static_cast<unsigned char>(field[end]) & 0xC0U) == 0x80U) --end;
  return "'" + printable(field.substr(0, end)) + (field.size() > end ? "...'" : "'");
}

}  // namespace chainslam::detail
