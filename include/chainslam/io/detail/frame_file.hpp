#pragma once

#include <unistd.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/error.hpp"
#include "chainslam/io/detail/byte_reader.hpp"
#include "chainslam/io/detail/map_chunk.hpp"
#include "chainslam/io/detail/map_records.hpp"
#include "chainslam/io/detail/open_to_read.hpp"
#include "chainslam/slam/frame_records.hpp"

namespace chainslam::detail {

/// The records of frames in a map's file or journal, read when they are asked for.
///
/// The file is read by its descriptor: it may grow meanwhile, get another name or lose it. Any thread may add and read.
class FrameFile final : public FrameSource {
 public:
  /// @param path        for messages.
  /// @param descriptor  of the file, open to be read, which this closes.
  FrameFile(std::filesystem::path path, int descriptor) : path_(std::move(path)), file_(descriptor) {}
  FrameFile(const FrameFile&) = delete;
  FrameFile& operator=(const FrameFile&) = delete;
  ~FrameFile() override { ::close(file_); }

  /// The records of a chunk follow those that are there.
  /// @param payload  of the chunk, which is sound.
  /// @param offset   of the payload in the file.
  void add(std::span<const std::byte> payload, std::uint64_t offset) {
    ByteReader in(payload);
    static_cast<void>(in.take<Index>());
    const std::size_t record_bytes = in.take<std::uint32_t>();
    const std::scoped_lock lock(mutex_);
    for (std::size_t at = block_prelude_bytes; at < payload.size();) {
      const std::size_t bytes = std::min(payload.size() - at, FrameRecords::block_records * record_bytes);
      const std::size_t count = bytes / record_bytes;
      parts_.push_back({offset + at, hash_of(payload.subspan(at, bytes)), size_, count, record_bytes});
      size_ += count;
      at += bytes;
    }
  }

  /// @throws IoError if they cannot be read any more, or have changed.
  [[nodiscard]] Records load(std::size_t first, std::size_t count) const override {
    const std::scoped_lock lock(mutex_);
    if (last_ && last_first_ == first && last_->size() == count) return last_;
    auto records = std::make_shared<std::vector<FrameRecord>>();
    records->reserve(count);
    auto part = std::upper_bound(parts_.begin(), parts_.end(), first,
                                 [](std::size_t number, const Part& one) { return number < one.first; });
    for (--part; records->size() < count; ++part) append(*part, first, first + count, *records);
    last_first_ = first;
    return last_ = std::move(records);
  }

 private:
  /// Records that follow one another in the file.
  struct Part {
    std::uint64_t offset;
    std::uint64_t hash;  ///< of their bytes
    std::size_t first;   ///< number of the first one
    std::size_t count;
    std::size_t record_bytes;
  };

  /// Those records of a part that are in [first, end).
  void append(const Part& part, std::size_t first, std::size_t end, std::vector<FrameRecord>& records) const {
    std::vector<std::byte> bytes(part.count * part.record_bytes);
    if (auto fault = read_at(file_, part.offset, bytes)) fail(part.offset, *std::move(fault));
    if (hash_of(bytes) != part.hash) fail(part.offset, "bytes that have changed since they were read or written");
    for (std::size_t i = std::max(first, part.first); i < std::min(end, part.first + part.count); ++i) {
      const std::size_t offset = (i - part.first) * part.record_bytes;
      ByteReader in(std::span<const std::byte>(bytes).subspan(offset, part.record_bytes));
      records.push_back(read_frame(in, [&] { return read_pose(in).pose(); }));  // checked before
    }
  }

  [[noreturn]] void fail(std::uint64_t offset, std::string found) const {
    throw_input_error(path_.string(), "frames at byte " + std::to_string(offset), std::move(found),
                      changed_file_remedy);
  }

  std::filesystem::path path_;
  int file_;
  mutable std::mutex mutex_;  ///< of all below
  std::vector<Part> parts_;
  std::size_t size_ = 0;
  mutable Records last_;  ///< read last: those who read take one record after the other
  mutable std::size_t last_first_ = 0;
};

}  // namespace chainslam::detail
