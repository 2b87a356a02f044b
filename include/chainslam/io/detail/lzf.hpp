#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

namespace chainslam::detail {

// LZF, the codec of PCD's binary_compressed. A stream of items, each with a control byte c:
//   c < 32:   c + 1 literal bytes follow;
//   c >= 32:  a copy of length (c >> 5) + 2, or, if c >> 5 is 7, of 9 plus the next byte; then a byte o. The copy
//   starts
//             ((c & 31) << 8 | o) + 1 bytes back and may overlap what it writes.
inline constexpr std::size_t lzf_longest_literal = 32;
inline constexpr std::size_t lzf_longest_copy = 264;
inline constexpr std::size_t lzf_farthest = 8192;

/// Unpacks into `out`, which must come out exactly full. False if the data are damaged; never reads or writes outside.
[[nodiscard]] inline bool lzf_decompress(std::span<const std::byte> in, std::span<std::byte> out) {
  std::size_t i = 0, o = 0;
  while (i < in.size()) {
    const auto control = static_cast<std::size_t>(in[i++]);
    if (control < 32) {
      const std::size_t count = control + 1;
      if (in.size() - i < count || out.size() - o < count) return false;
      std::copy_n(in.begin() + static_cast<std::ptrdiff_t>(i), count, out.begin() + static_cast<std::ptrdiff_t>(o));
      i += count;
      o += count;
      continue;
    }
    std::size_t length = control >> 5;
    if (in.size() - i < (length == 7 ? 2U : 1U)) return false;
    if (length == 7) length += static_cast<std::size_t>(in[i++]);
    length += 2;
    const std::size_t back = ((control & 31) << 8 | static_cast<std::size_t>(in[i++])) + 1;
    if (back > o || out.size() - o < length) return false;
    for (; length > 0; --length, ++o) out[o] = out[o - back];
  }
  return o == out.size();
}

/// Packs greedily, with a table of the places where each three bytes were seen last.
[[nodiscard]] inline std::vector<std::byte> lzf_compress(std::span<const std::byte> in) {
  constexpr std::size_t nowhere = std::numeric_limits<std::size_t>::max();
  std::vector<std::size_t> seen(std::size_t{1} << 14, nowhere);
  const auto key = [&](std::size_t i) {
    const auto three = static_cast<std::uint32_t>(in[i]) << 16 | static_cast<std::uint32_t>(in[i + 1]) << 8 |
                       static_cast<std::uint32_t>(in[i + 2]);
    return static_cast<std::size_t>((three * 2654435761U) >> 18);
  };
  std::vector<std::byte> out;
  std::size_t literals = 0;  // where those not yet written start
  const auto write_literals = [&](std::size_t end) {
    while (literals < end) {
      const std::size_t count = std::min(end - literals, lzf_longest_literal);
      out.push_back(static_cast<std::byte>(count - 1));
      const auto first = in.begin() + static_cast<std::ptrdiff_t>(literals);
      out.insert(out.end(), first, first + static_cast<std::ptrdiff_t>(count));
      literals += count;
    }
  };
  for (std::size_t i = 0; i + 2 < in.size();) {
    std::size_t& last = seen[key(i)];
    const std::size_t from = last;
    last = i;
    std::size_t length = 0;
    if (from != nowhere && i - from <= lzf_farthest)
      while (length < lzf_longest_copy && i + length < in.size() && in[from + length] == in[i + length]) ++length;
    if (length < 3) {
      ++i;
      continue;
    }
    write_literals(i);
    const std::size_t code = length - 2, back = i - from - 1;
    out.push_back(static_cast<std::byte>(std::min<std::size_t>(code, 7) << 5 | back >> 8));
    if (code >= 7) out.push_back(static_cast<std::byte>(code - 7));
    out.push_back(static_cast<std::byte>(back & 255));
    i += length;
    literals = i;
  }
  write_literals(in.size());
  return out;
}

}  // namespace chainslam::detail
