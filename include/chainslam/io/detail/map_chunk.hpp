#pragma once

// All of xxHash is compiled in. Where g++ inlines its AVX-512 intrinsics it warns of them (GCC bug 105593): AVX2 (2)
// gives the same hashes.
#define XXH_INLINE_ALL
#if defined(__GNUC__) && !defined(__clang__) && defined(__AVX512F__) && !defined(XXH_VECTOR)
#define XXH_VECTOR 2
#endif
#include <xxhash.h>

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "chainslam/core/byte_archive.hpp"
#include "chainslam/io/detail/byte_reader.hpp"
#include "chainslam/io/file_system.hpp"

namespace chainslam::detail {

// Headers of a map file and of its chunks; map_archive.hpp describes them byte by byte.

inline constexpr std::array<unsigned char, 8> map_magic = {0x89, 'C', 'S', 'L', 'A', 'M', '\r', '\n'};
inline constexpr std::uint16_t map_major = 1, map_minor = 4;
inline constexpr std::size_t map_header_bytes = 64, chunk_alignment = 64;
inline constexpr std::uint32_t chunk_magic = 0x4b4e'4843;  // "CHNK"
inline constexpr std::uint16_t critical = 0x8000;
inline constexpr std::uint64_t most_raw_bytes = std::uint64_t{1} << 28;
/// A scan of 6 raw bytes a point takes 12 in memory: with this bound, opening takes at most 19 times the file's size.
inline constexpr std::uint64_t most_raw_per_stored = 6;

enum class ChunkType : std::uint16_t {
  parameters = critical | 1,
  session = critical | 2,
  keyframes = critical | 3,
  scan = critical | 4,
  odometry = critical | 5,
  closures = critical | 6,
  refusals = 7,
  poses = critical | 8,
  gnss = critical | 9,
  commit = critical | 10,
  index = 11,
  end = critical | 12,
  frames = 13,
  fixes = 14,  // these two in input journals only
  loaded = 15,
};

[[nodiscard]] constexpr bool is_known_chunk(std::uint16_t type) {
  const unsigned number = type & ~static_cast<unsigned>(critical);
  const bool may_be_skipped =
      number == static_cast<unsigned>(ChunkType::refusals) || number == static_cast<unsigned>(ChunkType::index) ||
      number == static_cast<unsigned>(ChunkType::frames) || number == static_cast<unsigned>(ChunkType::fixes) ||
      number == static_cast<unsigned>(ChunkType::loaded);
  return number >= 1 && number <= 15 && may_be_skipped == ((type & critical) == 0);
}

/// What a chunk's type is called in messages.
[[nodiscard]] inline const char* chunk_name(std::uint16_t type) {
  constexpr std::array<const char*, 16> names = {
      "unknown kind", "parameters", "session", "keyframes", "scan", "odometry", "closures", "refusals",
      "poses",        "gnss",       "commit",  "index",     "end",  "frames",   "fixes",    "loaded"};
  return names[is_known_chunk(type) ? type & ~static_cast<unsigned>(critical) : 0U];
}

[[nodiscard]] inline std::uint64_t hash_of(std::span<const std::byte> bytes) {
  return XXH3_64bits(bytes.data(), bytes.size());
}

/// Bytes that a payload takes in the file, its padding among them.
[[nodiscard]] constexpr std::uint64_t padded(std::uint64_t bytes) {
  return (bytes + chunk_alignment - 1) / chunk_alignment * chunk_alignment;
}

struct MapHeader {
  std::uint16_t major = map_major;
  std::uint16_t minor = map_minor;
  std::uint64_t file_id = 0;
  std::uint64_t flags = 0;
};

struct ChunkHeader {
  std::uint16_t type = 0;
  std::uint16_t version = 1;
  std::uint32_t codec = RawCodec::id;
  std::uint32_t count = 0;
  std::uint64_t stored_bytes = 0;
  std::uint64_t raw_bytes = 0;
  std::uint64_t sequence = 0;
  std::uint64_t file_id = 0;
  std::uint64_t payload_hash = 0;  ///< of the stored bytes and their padding

  [[nodiscard]] bool is(ChunkType wanted) const { return type == static_cast<std::uint16_t>(wanted); }
  [[nodiscard]] bool is_critical() const { return (type & critical) != 0; }
};

/// Where a chunk lies, and what its header says.
struct PlacedChunk {
  std::uint64_t offset = 0;
  ChunkHeader header;

  [[nodiscard]] std::uint64_t end() const { return offset + map_header_bytes + padded(header.stored_bytes); }
};

inline void append_header_hash(std::vector<std::byte>& out) {
  append_bytes(out, hash_of(std::span(out).last(map_header_bytes - sizeof(std::uint64_t))));
}

inline void append_map_header(std::vector<std::byte>& out, const MapHeader& header) {
  for (const unsigned char c : map_magic) out.push_back(std::byte{c});
  append_bytes(out, header.major);
  append_bytes(out, header.minor);
  append_bytes(out, static_cast<std::uint32_t>(map_header_bytes));
  append_bytes(out, header.file_id);
  append_bytes(out, header.flags);
  out.resize(out.size() + 24);
  append_header_hash(out);
}

inline void append_chunk_header(std::vector<std::byte>& out, const ChunkHeader& header) {
  append_bytes(out, chunk_magic);
  append_bytes(out, header.type);
  append_bytes(out, header.version);
  append_bytes(out, header.codec);
  append_bytes(out, header.count);
  append_bytes(out, header.stored_bytes);
  append_bytes(out, header.raw_bytes);
  append_bytes(out, header.sequence);
  append_bytes(out, header.file_id);
  append_bytes(out, header.payload_hash);
  append_header_hash(out);
}

/// Appends a chunk whose payload is already packed. `header` needs type, version, codec, count, raw bytes, sequence and
/// file id.
/// @returns the whole header.
inline ChunkHeader append_chunk(std::vector<std::byte>& out, ChunkHeader header, std::vector<std::byte> payload) {
  header.stored_bytes = payload.size();
  payload.resize(padded(payload.size()));
  header.payload_hash = hash_of(payload);
  append_chunk_header(out, header);
  out.insert(out.end(), payload.begin(), payload.end());
  return header;
}

/// Whether 64 bytes end with the hash of those before.
[[nodiscard]] inline bool header_is_sound(std::span<const std::byte> header) {
  constexpr std::size_t hashed = map_header_bytes - sizeof(std::uint64_t);
  return load_as<std::uint64_t>(header.data() + hashed) == hash_of(header.first(hashed));
}

/// @param bytes  64, sound.
[[nodiscard]] inline ChunkHeader read_chunk_header(std::span<const std::byte> bytes) {
  ByteReader in(bytes.subspan(sizeof(chunk_magic)));
  ChunkHeader header;
  header.type = in.take<std::uint16_t>();
  header.version = in.take<std::uint16_t>();
  header.codec = in.take<std::uint32_t>();
  header.count = in.take<std::uint32_t>();
  header.stored_bytes = in.take<std::uint64_t>();
  header.raw_bytes = in.take<std::uint64_t>();
  header.sequence = in.take<std::uint64_t>();
  header.file_id = in.take<std::uint64_t>();
  header.payload_hash = in.take<std::uint64_t>();
  return header;
}

}  // namespace chainslam::detail
