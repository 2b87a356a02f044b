#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/io/detail/map_chunk.hpp"
#include "chainslam/io/detail/map_records.hpp"
#include "chainslam/io/detail/partial_file.hpp"
#include "chainslam/io/detail/scan_codec.hpp"
#include "chainslam/io/detail/scan_file.hpp"
#include "chainslam/io/detail/zstd_codec.hpp"

namespace chainslam::detail {

/// Writes a file of chunks, one after the other.
template <class Files>
class ChunkWriter {
 public:
  /// @throws IoError as `PartialFile`.
  ChunkWriter(std::filesystem::path path, bool overwrite, Files files)
      : file_(std::move(path), overwrite, std::move(files)) {}

  [[nodiscard]] PartialFile<Files>& file() { return file_; }
  [[nodiscard]] const PartialFile<Files>& file() const { return file_; }
  [[nodiscard]] std::uint64_t chunks() const { return places_.size(); }

  /// The file's header and its parameters.
  /// @param id  from what the file begins with, so that the same run gives the same file.
  void start(std::uint64_t id, std::vector<std::byte> parameters) {
    file_id_ = id;
    std::vector<std::byte> header;
    append_map_header(header, {.file_id = id});
    file_.write(header);
    append(ChunkType::parameters, 1, std::move(parameters));
  }

  /// @param header  as `append_chunk` needs it, without sequence and id; raw bytes for packed payloads only.
  PlacedChunk append(ChunkHeader header, std::vector<std::byte> payload) {
    if (header.raw_bytes == 0) header.raw_bytes = payload.size();
    header.sequence = places_.size();
    header.file_id = file_id_;
    const std::uint64_t offset = file_.size();
    places_.push_back({offset, header.type, header.version, header.count});
    std::vector<std::byte> chunk;
    const ChunkHeader whole = append_chunk(chunk, header, std::move(payload));
    file_.write(chunk);
    return {offset, whole};
  }
  void append(ChunkType type, std::uint32_t count, std::vector<std::byte> payload) {
    append({.type = static_cast<std::uint16_t>(type), .count = count}, std::move(payload));
  }

  /// Records [first, end) in blocks: the number of the first one, the size of each, then they themselves.
  /// @param placed  told each block's payload, and its offset in the file.
  template <class Append, class Placed>
  void append_records(ChunkType type, std::size_t record_bytes, Index first, Index end, Append&& append_record,
                      Placed&& placed) {
    for (Index begin = first; begin < end; begin += most_records) {
      const Index stop = std::min(end, begin + most_records);
      std::vector<std::byte> payload;
      payload.reserve(block_prelude_bytes + static_cast<std::size_t>(stop - begin) * record_bytes);
      append_bytes(payload, begin);
      append_bytes(payload, static_cast<std::uint32_t>(record_bytes));
      append_bytes(payload, std::uint64_t{0});
      for (Index i = begin; i < stop; ++i) append_record(payload, i);
      placed(std::span<const std::byte>(payload), file_.size() + map_header_bytes);
      append(type, static_cast<std::uint32_t>(stop - begin), std::move(payload));
    }
  }

  template <class Append>
  void append_records(ChunkType type, std::size_t record_bytes, Index first, Index end, Append&& append_record) {
    append_records(type, record_bytes, first, end, append_record, [](std::span<const std::byte>, std::uint64_t) {});
  }

  /// A scan that a file has by the same number is copied as it is stored there, neither unpacked nor packed again.
  /// @throws IoError if it cannot be read.
  PlacedChunk append_scan(KeyframeId keyframe, const KeyframeScan& scan) {
    const KeyframeScan::Place kept = scan.place();
    if (const auto* file = dynamic_cast<const ScanFile*>(kept.source.get()))
      if (const ScanFile::Place place = file->place(kept.number); place.keyframe == keyframe) {
        const ChunkHeader& header = place.chunk.header;
        return append({.type = header.type,
                       .version = header.version,
                       .codec = header.codec,
                       .count = header.count,
                       .raw_bytes = header.raw_bytes},
                      file->stored(place));
      }
    return append_scan(keyframe, *scan.load());
  }
  PlacedChunk append_scan(KeyframeId keyframe, const PointCloud<float>& cloud) {
    std::vector<std::byte> raw;
    detail::append_scan(raw, keyframe, cloud);
    ChunkHeader header{.type = static_cast<std::uint16_t>(ChunkType::scan),
                       .count = static_cast<std::uint32_t>(cloud.size()),
                       .raw_bytes = raw.size()};
    std::vector<std::byte> packed = ZstdCodec{}.compress(raw);
    // What packs too well is kept as it is: a file's size bounds the memory that opening it takes.
    if (packed.size() < raw.size() && raw.size() <= packed.size() * most_raw_per_stored) {
      header.codec = ZstdCodec::id;
      raw = std::move(packed);
    }
    return append(header, std::move(raw));
  }

  void append_commit(const MapCounts& counts) {
    std::vector<std::byte> payload;
    for (const Index number :
         {counts.sessions, counts.keyframes, counts.scans, counts.odometry, counts.closures, counts.refusals})
      append_bytes(payload, number);
    append_bytes(payload, std::uint64_t{0});
    append(ChunkType::commit, 1, std::move(payload));
  }

  void append_index_and_end() {
    const std::uint64_t index_offset = file_.size();
    const auto count = static_cast<std::uint32_t>(places_.size());
    std::vector<std::byte> index;
    for (const Place& place : places_) {
      append_bytes(index, place.offset);
      append_bytes(index, place.type);
      append_bytes(index, place.version);
      append_bytes(index, place.count);
    }
    append(ChunkType::index, count, std::move(index));
    std::vector<std::byte> end;
    append_bytes(end, index_offset);
    append_bytes(end, file_.size() + 2 * chunk_alignment);
    append(ChunkType::end, 1, std::move(end));
  }

  static constexpr Index most_records = 65536;  ///< in one chunk

 private:
  struct Place {
    std::uint64_t offset;
    std::uint16_t type;
    std::uint16_t version;
    std::uint32_t count;
  };

  PartialFile<Files> file_;
  std::uint64_t file_id_ = 0;
  std::vector<Place> places_;
};

}  // namespace chainslam::detail
