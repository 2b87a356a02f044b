#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

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

}  // namespace chainslam
