#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace chainslam::datasets {

/// How the chunks of a ROS 1 bag or an MCAP file are packed. lz4 and zstd are frames, not blocks.
enum class Compression { none, bz2, lz4, zstd };

/// By the name that the file writes; MCAP writes an empty one for none.
[[nodiscard]] std::optional<Compression> compression_of(std::string_view name);

/// What could be unpacked, and what was wrong with the rest, if anything.
struct Unpacked {
  std::vector<std::byte> bytes;
  std::string fault;  ///< empty if all is there
};

/// Unpacks a recording's chunks one after the other.
///
/// A chunk may become 256 MiB at most, and all of them together 64 times their packed size and 16 MiB, which recordings
/// of sensors do not come near: else a small file would take the time and memory of a huge one.
class ChunkUnpacker {
 public:
  /// Memory grows with what comes out, not with what is claimed.
  /// @param claimed  the size that the file states, which must be the size that comes out.
  [[nodiscard]] Unpacked unpack(Compression compression, std::span<const std::byte> packed, std::uint64_t claimed);

 private:
  static constexpr std::uint64_t largest_chunk = std::uint64_t{256} << 20;

  std::uint64_t allowed_ = std::uint64_t{16} << 20;  ///< bytes that may come out
};

}  // namespace chainslam::datasets
