#pragma once

#include <unistd.h>

#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "chainslam/core/error.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/io/detail/map_chunk.hpp"
#include "chainslam/io/detail/map_records.hpp"
#include "chainslam/io/detail/open_to_read.hpp"
#include "chainslam/io/detail/scan_codec.hpp"
#include "chainslam/io/detail/zstd_codec.hpp"
#include "chainslam/slam/keyframe_scan.hpp"

namespace chainslam::detail {

/// What keeps a scan's head from being that of its chunk; nothing if it is.
/// @param points  as the chunk's header has them.
/// @param left    bytes behind the head.
inline MaybeFault fault_of(const ScanHead& head, std::uint32_t points, std::uint64_t left) {
  if (head.encoding > scan_on_grid || (head.columns & ~scan_all_columns) != 0)
    return Fault{"encoding", std::to_string(head.encoding) + ", columns " + std::to_string(head.columns)};
  if (head.points != points || scan_body_bytes(head.encoding, head.columns, head.points) != left)
    return Fault{"points", std::to_string(head.points) + " in " + std::to_string(left) + " bytes"};
  if (head.encoding == scan_on_grid && (!is_finite(head.grid.step) || !(head.grid.step > 0)))
    return Fault{"step", std::to_string(head.grid.step)};
  return std::nullopt;
}

/// The scans of a map's file or journal, each read when it is asked for; those used last stay in a cache.
///
/// The file is read by its descriptor: it may grow meanwhile, get another name or lose it. Any thread may add and read.
class ScanFile final : public ScanSource, public std::enable_shared_from_this<ScanFile> {
 public:
  using Cloud = std::shared_ptr<const PointCloud<float>>;

  /// A scan's chunk.
  struct Place {
    KeyframeId keyframe;  ///< whose scan it is, by the numbers of this file
    PlacedChunk chunk;
  };

  /// @param path        for messages.
  /// @param descriptor  of the file, open to be read, which this closes.
  ScanFile(std::filesystem::path path, int descriptor, std::shared_ptr<ScanCache> cache)
      : path_(std::move(path)), file_(descriptor), cache_(std::move(cache)), source_(cache_->add_source()) {}
  ScanFile(const ScanFile&) = delete;
  ScanFile& operator=(const ScanFile&) = delete;
  ~ScanFile() override {
    cache_->drop_source(source_);
    ::close(file_);
  }

  /// The scan that the chunk at a place has.
  [[nodiscard]] KeyframeScan scan(const Place& place) {
    return {shared_from_this(), append(place), place.chunk.header.count};
  }

  /// Keeps a scan that was written to the chunk at a place: its points go from memory once the cache lets them go.
  void take(const KeyframeScan& scan, const Place& place) {
    const Cloud cloud = scan.place().cloud;
    if (!cloud) return;
    const std::size_t number = append(place);
    cache_->keep(source_, number, cloud);
    scan.keep_in(shared_from_this(), number);
  }

  /// @throws IoError if it cannot be read any more, is damaged, or breaks the format's rules.
  [[nodiscard]] Cloud load(std::size_t number) const override {
    if (Cloud cached = cache_->find(source_, number)) return cached;
    return cache_->keep(source_, number, std::make_shared<const PointCloud<float>>(read(place(number))));
  }

  [[nodiscard]] Place place(std::size_t number) const {
    const std::scoped_lock lock(mutex_);
    return places_[number];
  }

  /// A scan's payload as it is stored, without padding. @throws IoError if it cannot be read any more, or is damaged.
  [[nodiscard]] std::vector<std::byte> stored(const Place& place) const {
    std::vector<std::byte> bytes(padded(place.chunk.header.stored_bytes));
    if (auto fault = read_at(file_, place.chunk.offset + map_header_bytes, bytes)) fail(place, *std::move(fault));
    if (hash_of(bytes) != place.chunk.header.payload_hash) fail(place, "bytes that do not match their checksum");
    bytes.resize(place.chunk.header.stored_bytes);
    return bytes;
  }

 private:
  [[nodiscard]] PointCloud<float> read(const Place& place) const {
    const ChunkHeader& header = place.chunk.header;
    std::vector<std::byte> payload = stored(place);
    if (header.codec == ZstdCodec::id) {
      std::vector<std::byte> raw(header.raw_bytes);
      if (!ZstdCodec{}.decompress(payload, raw))
        fail(place, "a payload that does not unpack to " + std::to_string(raw.size()) + " bytes");
      payload = std::move(raw);
    }
    if (payload.size() < scan_head_bytes) fail(place, std::to_string(payload.size()) + " bytes");
    ByteReader in(payload);
    const ScanHead head = read_scan_head(in);
    if (head.keyframe != place.keyframe) fail(place, "the scan of keyframe " + std::to_string(head.keyframe.value));
    if (const auto fault = fault_of(head, header.count, in.left())) fail(place, fault->field + ": " + fault->found);
    return read_scan_body(head, in);
  }

  std::size_t append(const Place& place) {
    const std::scoped_lock lock(mutex_);
    places_.push_back(place);
    return places_.size() - 1;
  }

  [[noreturn]] void fail(const Place& place, std::string found) const {
    throw_input_error(
        path_.string(),
        "scan of keyframe " + std::to_string(place.keyframe.value) + " at byte " + std::to_string(place.chunk.offset),
        std::move(found), changed_file_remedy);
  }

  std::filesystem::path path_;
  int file_;
  std::shared_ptr<ScanCache> cache_;
  std::uint64_t source_;  ///< what the cache knows this by
  mutable std::mutex mutex_;
  std::vector<Place> places_;  ///< guarded by `mutex_`
};

}  // namespace chainslam::detail
