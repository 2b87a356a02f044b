#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <utility>

#include "chainslam/core/byte_archive.hpp"
#include "chainslam/core/error.hpp"

namespace chainslam::detail {

// A saved tree, format 1. Numbers are little-endian, f is IEEE 754.
//
//    0  89 43 53 49 4B 44 0D 0A   mark ("\x89CSIKD\r\n")
//    8  u32 1          version: another cannot be read
//   12  u8 4 or 8      bytes of a coordinate
//   13  u8 2 or 3      dimension
//   14  u16 0 or 2     bytes of what the voxel of a point remembers
//   16  u32            bytes of a payload
//   20  u32            points refused so far
//   24  f64            edge of the voxels, 0 without downsampling
//   32  u64 n          points
//   40  u64            check number: FNV-1a of bytes 0 to 39 and 48 to the end
//   48  n x dimension coordinates, n x u16 of the voxels, n payloads as they lie in memory

/// What a saved tree says of itself.
struct TreeHeader {
  std::uint8_t scalar_bytes = 0;
  std::uint8_t dimension = 0;
  std::uint16_t state_bytes = 0;
  std::uint32_t payload_bytes = 0;
  std::uint32_t rejected = 0;
  double voxel_size = 0;
  std::uint64_t points = 0;

  static constexpr std::size_t bytes = 48;
  [[nodiscard]] std::size_t bytes_per_point() const {
    return std::size_t{scalar_bytes} * dimension + state_bytes + payload_bytes;
  }
};

inline constexpr std::uint64_t tree_mark = 0x0A0D'444B'4953'4389U;
inline constexpr std::uint32_t tree_version = 1;
inline constexpr std::size_t tree_check_at = 40;

template <class Sink>
void put_header(Sink& out, const TreeHeader& header) {
  out.put(tree_mark);
  out.put(tree_version);
  out.put(header.scalar_bytes);
  out.put(header.dimension);
  out.put(header.state_bytes);
  out.put(header.payload_bytes);
  out.put(header.rejected);
  out.put(header.voxel_size);
  out.put(header.points);
  out.put(std::uint64_t{0});
}

/// Says what is wrong with a saved tree.
[[noreturn]] inline void refuse_tree(const std::string& name, std::size_t byte, std::string found) {
  throw_input_error(name, "byte " + std::to_string(byte), std::move(found),
                    "save the tree again with the program that made it, or build it from its points");
}

/// Reads the header and checks it against what the reader expects, and the length and the check number of the whole.
/// @throws IoError naming `name` and the byte.
[[nodiscard]] inline TreeHeader check_tree(std::span<const std::byte> bytes, const TreeHeader& expected,
                                           const std::string& name) {
  if (bytes.size() < TreeHeader::bytes)
    refuse_tree(name, bytes.size(), "the end, where a header of 48 bytes is expected");
  ByteSource in(bytes);
  if (in.take<std::uint64_t>() != tree_mark) refuse_tree(name, 0, "something that is not a saved tree");
  if (const auto version = in.take<std::uint32_t>(); version != tree_version)
    refuse_tree(name, 8, "format version " + std::to_string(version) + ", where this program reads 1");
  TreeHeader header;
  header.scalar_bytes = in.take<std::uint8_t>();
  header.dimension = in.take<std::uint8_t>();
  header.state_bytes = in.take<std::uint16_t>();
  header.payload_bytes = in.take<std::uint32_t>();
  header.rejected = in.take<std::uint32_t>();
  header.voxel_size = in.take<double>();
  header.points = in.take<std::uint64_t>();
  if (header.scalar_bytes != expected.scalar_bytes || header.dimension != expected.dimension)
    refuse_tree(name, 12,
                "coordinates of another kind: " + std::to_string(header.scalar_bytes) + " bytes, " +
                    std::to_string(header.dimension) + " dimensions");
  if (header.state_bytes != expected.state_bytes || header.voxel_size != expected.voxel_size)
    refuse_tree(name, 24, "another downsampling, with voxels of " + std::to_string(header.voxel_size) + " m");
  if (header.payload_bytes != expected.payload_bytes)
    refuse_tree(name, 16, "payloads of " + std::to_string(header.payload_bytes) + " bytes");
  const std::size_t body = bytes.size() - TreeHeader::bytes;
  if (body % header.bytes_per_point() != 0 || body / header.bytes_per_point() != header.points)
    refuse_tree(name, 32, std::to_string(header.points) + " points announced in " + std::to_string(body) + " bytes");
  if (in.take<std::uint64_t>() != check_number(bytes, tree_check_at))
    refuse_tree(name, tree_check_at, "a check number that is not that of the bytes");
  if (header.rejected > 0x7fff'ffffU || header.points > 0x7fff'ffffU)
    refuse_tree(name, 20, "more than 2^31 - 1 points");
  return header;
}

}  // namespace chainslam::detail
