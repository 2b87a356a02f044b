#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>

namespace chainslam::support {

/// Text as HTML text or attribute value: no character of it can open a tag, an entity or end a quote, and what is no
/// printable text is escaped.
[[nodiscard]] std::string escape_html(std::string_view text);

/// RFC 4648, section 4, with padding.
[[nodiscard]] std::string base64(std::span<const std::byte> bytes);

/// FIPS 180-4, section 6.2.
[[nodiscard]] std::array<std::uint8_t, 32> sha256(std::string_view text);

}  // namespace chainslam::support
