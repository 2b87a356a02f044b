#pragma once

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "chainslam/core/error.hpp"
#include "chainslam/io/detail/map_chunk.hpp"
#include "chainslam/io/detail/open_to_read.hpp"
#include "chainslam/io/detail/zstd_codec.hpp"

namespace chainslam::detail {

/// The chunks of a map file: walks their headers and reads payloads, believing nothing that is not checked first.
class MapFileReader {
 public:
  /// @throws IoError if it cannot be read, is no map, or needs a newer version.
  explicit MapFileReader(std::filesystem::path path) : path_(std::move(path)) {
    file_ = open_to_read(path_);
    if (file_ < 0)
      fail("", errno == ENOENT || errno == ENOTDIR ? "no such file" : std::generic_category().message(errno),
           "check the path, and that you may read it");
    try {
      struct stat information {};
      if (::fstat(file_, &information) != 0 || !S_ISREG(information.st_mode))
        fail("", "not a plain file (a folder, a pipe or a device)", "name a map file");
      size_ = static_cast<std::uint64_t>(information.st_size);
      read_map_header();
      walk();
    } catch (...) {
      ::close(file_);
      throw;
    }
  }
  MapFileReader(const MapFileReader&) = delete;
  MapFileReader& operator=(const MapFileReader&) = delete;
  ~MapFileReader() { ::close(file_); }

  [[nodiscard]] const std::filesystem::path& path() const { return path_; }
  /// Another descriptor of the open file, which the caller closes. @throws IoError
  [[nodiscard]] int duplicate() const {
    const int file = ::fcntl(file_, F_DUPFD_CLOEXEC, 0);
    if (file < 0) fail("", std::generic_category().message(errno), "allow more open files (ulimit -n)");
    return file;
  }
  [[nodiscard]] const MapHeader& header() const { return header_; }
  [[nodiscard]] std::uint64_t size() const { return size_; }
  /// All chunks with sound headers, from the file's start to the first that is not there or not sound.
  [[nodiscard]] const std::vector<PlacedChunk>& chunks() const { return chunks_; }
  /// Why the walk ended before the file's end; empty if it did not.
  [[nodiscard]] const std::string& stop() const { return stop_; }

  [[nodiscard]] std::string place(std::size_t number) const {
    return "chunk " + std::to_string(number) + " (" + chunk_name(chunks_[number].header.type) + ") at byte " +
           std::to_string(chunks_[number].offset);
  }

  /// The payload as it is stored, without padding; nothing if it is damaged.
  [[nodiscard]] std::optional<std::vector<std::byte>> stored_payload(std::size_t number) const {
    const PlacedChunk& chunk = chunks_[number];
    std::vector<std::byte> bytes(padded(chunk.header.stored_bytes));
    read(chunk.offset + map_header_bytes, bytes);
    if (hash_of(bytes) != chunk.header.payload_hash) return std::nullopt;
    bytes.resize(chunk.header.stored_bytes);
    return bytes;
  }

  /// The payload, unpacked; nothing if it is damaged.
  [[nodiscard]] std::optional<std::vector<std::byte>> payload(std::size_t number) const {
    auto stored = stored_payload(number);
    const ChunkHeader& header = chunks_[number].header;
    if (!stored || header.codec == RawCodec::id) return stored;
    std::vector<std::byte> raw(header.raw_bytes);
    if (!ZstdCodec{}.decompress(*stored, raw))
      fail(place(number), "a payload that does not unpack to " + std::to_string(raw.size()) + " bytes",
           written_wrongly);
    return raw;
  }

  static constexpr const char* written_wrongly =
      "the program that wrote the file broke its format: make the map again, or take an older copy";

  [[noreturn]] void fail(std::string place, std::string found, std::string remedy) const {
    throw_input_error(path_.string(), std::move(place), std::move(found), std::move(remedy));
  }

 private:
  void read(std::uint64_t offset, std::span<std::byte> bytes) const {
    if (auto fault = read_at(file_, offset, bytes))
      fail("byte " + std::to_string(offset), *std::move(fault),
           "check the disk, and that nothing else writes the file");
  }

  void read_map_header() {
    std::array<std::byte, map_header_bytes> bytes{};
    if (size_ < bytes.size())
      fail("", std::to_string(size_) + " bytes, which is no map", "check that this is the right file");
    read(0, bytes);
    const bool magic = std::equal(map_magic.begin(), map_magic.end(), bytes.begin(),
                                  [](unsigned char c, std::byte b) { return std::byte{c} == b; });
    if (!magic) fail("byte 0", "no map's mark", "check that this is the right file; maps are made by `chainslam map`");
    if (!header_is_sound(bytes))
      fail("byte 0, the file's header", "bytes that do not match their checksum",
           "the file was damaged: take an older copy");
    ByteReader in(std::span<const std::byte>(bytes).subspan(map_magic.size()));
    header_.major = in.take<std::uint16_t>();
    header_.minor = in.take<std::uint16_t>();
    const std::uint32_t length = in.take<std::uint32_t>();
    header_.file_id = in.take<std::uint64_t>();
    header_.flags = in.take<std::uint64_t>();
    const std::string version = std::to_string(header_.major) + '.' + std::to_string(header_.minor);
    if (header_.major != map_major || length != map_header_bytes || header_.flags != 0)
      fail("byte 8, the file's header",
           "format " + version + ", header of " + std::to_string(length) + " bytes, flags " +
               std::to_string(header_.flags),
           "this program reads format " + std::to_string(map_major) + ": take one that reads format " + version);
  }

  void walk() {
    std::uint64_t offset = map_header_bytes;
    while (offset < size_) {
      if (size_ - offset < map_header_bytes) return stop_at(offset, "a chunk's header that was cut short");
      std::array<std::byte, map_header_bytes> bytes{};
      read(offset, bytes);
      if (load_as<std::uint32_t>(bytes.data()) != chunk_magic || !header_is_sound(bytes))
        return stop_at(offset, "no sound header of a chunk");
      const PlacedChunk chunk{offset, read_chunk_header(bytes)};
      if (chunk.header.file_id != header_.file_id || chunk.header.sequence != chunks_.size())
        return stop_at(offset, "a chunk of another file or place");
      const std::uint64_t left = size_ - offset - map_header_bytes;
      if (chunk.header.stored_bytes > left || padded(chunk.header.stored_bytes) > left)
        return stop_at(offset, "a chunk that was cut short");
      chunks_.push_back(chunk);
      check_claims(chunks_.size() - 1);
      offset = chunk.end();
    }
  }

  void stop_at(std::uint64_t offset, const char* what) { stop_ = "byte " + std::to_string(offset) + ": " + what; }

  /// What a header promises must be possible before memory is taken for it.
  void check_claims(std::size_t number) const {
    const ChunkHeader& header = chunks_[number].header;
    if (!is_known_chunk(header.type)) {
      if (header.is_critical())
        fail(place(number), "type " + std::to_string(header.type) + ", without which the map would be wrong",
             "take a newer version of the program: format " + std::to_string(header_.major) + '.' +
                 std::to_string(header_.minor) + " is newer than this one's " + std::to_string(map_major) + '.' +
                 std::to_string(map_minor));
      return;
    }
    const bool packed = header.codec == ZstdCodec::id && header.is(ChunkType::scan);
    if (header.codec != RawCodec::id && !packed)
      fail(place(number) + ", codec", std::to_string(header.codec), "take a newer version of the program");
    if (header.raw_bytes > most_raw_bytes || (!packed && header.raw_bytes != header.stored_bytes) ||
        (packed && header.raw_bytes > most_raw_per_stored * header.stored_bytes))
      fail(place(number) + ", raw bytes",
           std::to_string(header.raw_bytes) + " from " + std::to_string(header.stored_bytes) + " stored ones",
           written_wrongly);
  }

  std::filesystem::path path_;
  int file_ = -1;
  std::uint64_t size_ = 0;
  MapHeader header_;
  std::vector<PlacedChunk> chunks_;
  std::string stop_;
};

}  // namespace chainslam::detail
