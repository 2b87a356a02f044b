#pragma once

#include <zstd.h>

#include <cstddef>
#include <cstdint>
#include <new>
#include <span>
#include <vector>

#include "chainslam/io/file_system.hpp"

namespace chainslam::detail {

/// Zstandard (RFC 8878), one frame that states its size.
struct ZstdCodec {
  static constexpr std::uint32_t id = 1;  ///< 1 in a chunk's header

  int level = 1;  ///< 1 is fastest; higher levels gain a tenth at most on scans

  /// As a Zstandard frame.
  [[nodiscard]] std::vector<std::byte> compress(std::span<const std::byte> in) const {
    std::vector<std::byte> out(ZSTD_compressBound(in.size()));
    const std::size_t size = ZSTD_compress(out.data(), out.size(), in.data(), in.size(), level);
    if (ZSTD_isError(size)) throw std::bad_alloc();  // with room for the worst case, nothing else can fail
    out.resize(size);
    return out;
  }

  /// The frame has to state `out`'s size.
  [[nodiscard]] bool decompress(std::span<const std::byte> in, std::span<std::byte> out) const {
    if (ZSTD_getFrameContentSize(in.data(), in.size()) != out.size()) return false;
    return ZSTD_decompress(out.data(), out.size(), in.data(), in.size()) == out.size();
  }
};
static_assert(Codec<ZstdCodec>);

}  // namespace chainslam::detail
