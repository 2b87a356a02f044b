#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <string>
#include <string_view>

#include "chainslam/io/detail/map_chunk.hpp"

namespace chainslam::test {

/// A map file's bytes with every mark, sequence number and checksum put right, chunk by chunk, as far as its chunks'
/// sizes lead; nothing else of it is changed.
inline std::string sealed(std::string_view file) {
  constexpr std::size_t header = detail::map_header_bytes, hashed = header - sizeof(std::uint64_t);
  std::string bytes(file);
  if (bytes.size() < header) return bytes;
  const auto put = [&](std::size_t at, auto value) { std::memcpy(bytes.data() + at, &value, sizeof value); };
  const auto hash = [&](std::size_t at, std::size_t size) {
    return detail::hash_of(std::as_bytes(std::span(bytes).subspan(at, size)));
  };
  const auto number = [&](std::size_t at) {
    std::uint64_t value = 0;
    std::memcpy(&value, bytes.data() + at, sizeof value);
    return value;
  };
  std::copy(detail::map_magic.begin(), detail::map_magic.end(), bytes.begin());
  put(8, detail::map_major);
  put(12, static_cast<std::uint32_t>(header));
  put(24, std::uint64_t{0});
  const std::uint64_t id = number(16);
  put(hashed, hash(0, hashed));
  std::uint64_t sequence = 0;
  for (std::size_t at = header; bytes.size() - at >= header;) {
    put(at, detail::chunk_magic);
    put(at + 32, sequence++);
    put(at + 40, id);
    const std::uint64_t stored = number(at + 24), left = bytes.size() - at - header;
    const bool there = stored <= left && detail::padded(stored) <= left;
    if (there) put(at + 48, hash(at + header, static_cast<std::size_t>(detail::padded(stored))));
    put(at + hashed, hash(at, hashed));
    if (!there) break;
    at += header + static_cast<std::size_t>(detail::padded(stored));
  }
  return bytes;
}

}  // namespace chainslam::test
