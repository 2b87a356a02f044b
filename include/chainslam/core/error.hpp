#pragma once

#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>

namespace chainslam {

namespace detail {

/// The character at the start of `text`, and how many bytes it takes; 0 bytes if they are no UTF-8 (RFC 3629).
struct Utf8Character {
  std::uint32_t value = 0;
  std::size_t bytes = 0;
};

inline Utf8Character first_character(std::string_view text) {
  const auto byte = [&](std::size_t i) { return static_cast<std::uint8_t>(text[i]); };
  const std::uint8_t lead = byte(0);
  if (lead < 0x80) return {lead, 1};
  const std::size_t bytes = lead >= 0xF0 ? 4 : lead >= 0xE0 ? 3 : 2;
  if (lead < 0xC2 || lead > 0xF4 || text.size() < bytes) return {};
  std::uint32_t value = lead & (0xFFU >> (bytes + 1));
  for (std::size_t i = 1; i < bytes; ++i) {
    if ((byte(i) & 0xC0U) != 0x80U) return {};
    value = value << 6 | (byte(i) & 0x3FU);
  }
  const bool too_long = (bytes == 3 && value < 0x800) || (bytes == 4 && value < 0x10000);
  if (too_long || value > 0x10FFFF || (value >= 0xD800 && value <= 0xDFFF)) return {};
  return {value, bytes};
}

/// Whether a character does something else than to show itself: controls, which terminals obey, and marks that turn
/// the direction of what follows or break the line (Unicode's C0, C1, bidirectional controls and separators).
inline bool is_control(std::uint32_t c) {
  return c < 0x20 || (c >= 0x7F && c < 0xA0) || c == 0x061C || c == 0x200E || c == 0x200F ||
         (c >= 0x2028 && c <= 0x202E) || (c >= 0x2066 && c <= 0x2069) || c == 0xFEFF;
}

}  // namespace detail

/// Text from outside (a file's name, a field, a topic) as it may be printed: control characters and bytes that are no
/// UTF-8 become `\x1B`, byte by byte, so that no text can steer a terminal or pass for another line.
/// @param lines  whether line feeds are kept, for text of several lines.
[[nodiscard]] inline std::string printable(std::string_view text, bool lines = false) {
  constexpr std::string_view digits = "0123456789ABCDEF";
  std::string result;
  result.reserve(text.size());
  while (!text.empty()) {
    const detail::Utf8Character character = detail::first_character(text);
    const bool plain = character.bytes > 0 && (!detail::is_control(character.value) || (lines && text[0] == '\n'));
    const std::size_t bytes = character.bytes > 0 ? character.bytes : 1;
    for (std::size_t i = 0; i < bytes; ++i) {
      if (plain) {
        result += text[i];
        continue;
      }
      const auto byte = static_cast<std::uint8_t>(text[i]);
      result += "\\x";
      result += digits[byte >> 4];
      result += digits[byte & 15U];
    }
    text.remove_prefix(bytes);
  }
  return result;
}

/// A file or device that could not be read or written as asked.
///
/// `what()` is three lines: path and place; what was found; what to do. What is not fit to be printed is escaped there.
class IoError : public std::runtime_error {
 public:
  /// Whether something was read or written.
  enum class Kind { input, output };

  /// What the message is made of.
  struct Report {
    std::string path;    ///< file or directory as the caller named it
    std::string place;   ///< "line 12, field qx" or "byte 4096"; empty if the whole file is meant
    std::string found;   ///< what was found there
    std::string remedy;  ///< what the user can do
  };

  /// Made by `throw_input_error` and `throw_output_error`.
  IoError(Kind kind, Report report) : std::runtime_error(format(report)), kind_(kind), report_(std::move(report)) {}

  [[nodiscard]] Kind kind() const { return kind_; }               ///< whether something was read or written
  [[nodiscard]] const Report& report() const { return report_; }  ///< file, place, finding and remedy, one by one

 private:
  static std::string format(const Report& report) {
    return printable(report.path) + (report.place.empty() ? "" : ", " + printable(report.place)) +
           "\n  found: " + printable(report.found) + "\n  do: " + printable(report.remedy, true);
  }

  Kind kind_;
  Report report_;
};

/// Throws an `IoError` about something read.
[[noreturn]] inline void throw_input_error(std::string path, std::string place, std::string found, std::string remedy) {
  throw IoError(IoError::Kind::input, {std::move(path), std::move(place), std::move(found), std::move(remedy)});
}

/// Throws an `IoError` about something written.
[[noreturn]] inline void throw_output_error(std::string path, std::string place, std::string found,
                                            std::string remedy) {
  throw IoError(IoError::Kind::output, {std::move(path), std::move(place), std::move(found), std::move(remedy)});
}

}  // namespace chainslam
