#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <iterator>
#include <limits>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sensor/frame.hpp"

namespace chainslam {

/// Where records of frames can be read again, bit for bit: a map's file, for instance. Any number of threads may read
/// at once.
class FrameSource {
 public:
  /// Consecutive records.
  using Records = std::shared_ptr<const std::vector<FrameRecord>>;

  virtual ~FrameSource() = default;
  /// Records [first, first + count) of this source.
  /// @throws IoError if they cannot be read any more.
  [[nodiscard]] virtual Records load(std::size_t first, std::size_t count) const = 0;
};

/// The frames of a map: the newest in memory, the others in blocks, which are in memory or read from where they are
/// stored when they are asked for.
///
/// Records that are there never change; copies share the blocks. Where a block is kept may change (`keep_in`), also
/// while other threads read it.
class FrameRecords {
 public:
  static constexpr std::size_t block_records = 1024;  ///< in a block; as many of the newest are always in memory

  /// Adds one behind the others. Its residual is rounded to float, as files keep it.
  void push_back(FrameRecord frame) {
    frame.health.residual_rms = static_cast<double>(static_cast<float>(frame.health.residual_rms));
    newest_.push_back(frame);
    if (newest_.size() < 2 * block_records) return;
    const auto end = newest_.begin() + block_records;
    blocks_.push_back(std::make_shared<Block>(std::make_shared<const std::vector<FrameRecord>>(newest_.begin(), end)));
    newest_.erase(newest_.begin(), end);
  }

  [[nodiscard]] std::size_t size() const { return in_blocks() + newest_.size(); }  ///< how many there are
  [[nodiscard]] bool empty() const { return newest_.empty(); }                     ///< whether there are none
  /// The newest one, which there must be.
  [[nodiscard]] const FrameRecord& back() const { return newest_.back(); }
  /// A copy of one: const, since changing it would change nothing here.
  /// @throws IoError if it cannot be read any more, as all that follow.
  [[nodiscard]] const FrameRecord operator[](std::size_t i) const {
    return i < in_blocks() ? (*records(i / block_records))[i % block_records] : newest_[i - in_blocks()];
  }

  /// Records [first, end).
  [[nodiscard]] std::vector<FrameRecord> copy(std::size_t first, std::size_t end) const {
    std::vector<FrameRecord> frames;
    frames.reserve(end - first);
    while (first < std::min(end, in_blocks())) {
      const FrameSource::Records block = records(first / block_records);
      const std::size_t offset = first % block_records, count = std::min(end - first, block_records - offset);
      const auto begin = block->begin() + static_cast<std::ptrdiff_t>(offset);
      frames.insert(frames.end(), begin, begin + static_cast<std::ptrdiff_t>(count));
      first += count;
    }
    for (; first < end; ++first) frames.push_back(newest_[first - in_blocks()]);
    return frames;
  }
  /// Those of one session: sessions must follow one another, as in every map.
  [[nodiscard]] std::vector<FrameRecord> of(SessionId session) const {
    constexpr auto earliest = Timestamp::from_nanoseconds(std::numeric_limits<std::int64_t>::min());
    return copy(first_from({session, earliest}), first_from({SessionId{session.value + 1}, earliest}));
  }
  /// Those of one session in [from, to]: times must increase in each, as in every map.
  [[nodiscard]] std::vector<FrameRecord> between(SessionId session, Timestamp from, Timestamp to) const {
    std::vector<FrameRecord> frames;
    for (auto frame = Iterator(*this, first_from({session, from})); frame != end(); ++frame) {
      if (frame->session != session || frame->time > to) break;
      frames.push_back(*frame);
    }
    return frames;
  }

  /// Reads them one after the other; each holds until the iterator moves on.
  class Iterator {
   public:
    using value_type = FrameRecord;                     ///< as `std::input_iterator` has it
    using difference_type = std::ptrdiff_t;             ///< the same
    using iterator_concept = std::input_iterator_tag;   ///< the same
    using iterator_category = std::input_iterator_tag;  ///< the same
    using reference = const FrameRecord&;               ///< the same
    using pointer = const FrameRecord*;                 ///< the same

    Iterator() = default;
    /// At record `i`.
    Iterator(const FrameRecords& frames, std::size_t i) : frames_(&frames), i_(i) { load(); }

    [[nodiscard]] reference operator*() const {  ///< the record
      return block_ ? (*block_)[i_ % block_records] : frames_->newest_[i_ - frames_->in_blocks()];
    }
    [[nodiscard]] pointer operator->() const { return &**this; }  ///< the record
    Iterator& operator++() {                                      ///< moves on
      if (++i_ % block_records == 0) load();
      return *this;
    }
    void operator++(int) { ++*this; }                                                      ///< moves on
    friend bool operator==(const Iterator& a, const Iterator& b) { return a.i_ == b.i_; }  ///< of the same records

   private:
    void load() { block_ = i_ < frames_->in_blocks() ? frames_->records(i_ / block_records) : nullptr; }

    const FrameRecords* frames_ = nullptr;
    std::size_t i_ = 0;
    FrameSource::Records block_;  ///< null among the newest
  };
  [[nodiscard]] Iterator begin() const { return {*this, 0}; }     ///< the first
  [[nodiscard]] Iterator end() const { return {*this, size()}; }  ///< behind the last

  /// From now on these blocks, and all copies of them, are read from a source that has the same records by the same
  /// numbers: whole blocks of [first, end), `first` being where one begins. Copies in memory go.
  /// @returns where the next block begins.
  std::size_t keep_in(const std::shared_ptr<const FrameSource>& source, std::size_t first, std::size_t end) const {
    for (; first + block_records <= std::min(end, in_blocks()); first += block_records)
      blocks_[first / block_records]->keep_in(source, first);
    return first;
  }

 private:
  using SortKey = std::pair<SessionId, Timestamp>;
  [[nodiscard]] static SortKey key_of(const FrameRecord& frame) { return {frame.session, frame.time}; }

  /// Records of one block: in memory, or in a source.
  class Block {
   public:
    explicit Block(FrameSource::Records records) : first_key_(key_of(records->front())), records_(std::move(records)) {}

    [[nodiscard]] const SortKey& first_key() const { return first_key_; }
    [[nodiscard]] FrameSource::Records load() const {
      std::unique_lock lock(mutex_);
      if (records_) return records_;
      const auto source = source_;
      const std::size_t first = first_;
      lock.unlock();
      return source->load(first, block_records);
    }
    void keep_in(std::shared_ptr<const FrameSource> source, std::size_t first) {
      FrameSource::Records released;  // outside the lock
      const std::scoped_lock lock(mutex_);
      released.swap(records_);
      source_ = std::move(source);
      first_ = first;
    }

   private:
    const SortKey first_key_;   ///< of the first record
    mutable std::mutex mutex_;  ///< of all below
    FrameSource::Records records_;
    std::shared_ptr<const FrameSource> source_;
    std::size_t first_ = 0;  ///< number of the first record in `source_`
  };

  [[nodiscard]] std::size_t in_blocks() const { return blocks_.size() * block_records; }
  [[nodiscard]] FrameSource::Records records(std::size_t block) const { return blocks_[block]->load(); }

  /// Number of the first one that is not before the key.
  [[nodiscard]] std::size_t first_from(const SortKey& key) const {
    const auto before = [&](const FrameRecord& frame) { return key_of(frame) < key; };
    if (blocks_.empty() || before(newest_.front())) return in_blocks() + count_of(newest_, before);
    const auto later = std::partition_point(blocks_.begin(), blocks_.end(),
                                            [&](const auto& block) { return block->first_key() < key; });
    if (later == blocks_.begin()) return 0;
    const auto block = static_cast<std::size_t>(later - blocks_.begin()) - 1;
    return block * block_records + count_of(*records(block), before);
  }
  template <class Predicate>
  [[nodiscard]] static std::size_t count_of(const std::vector<FrameRecord>& frames, const Predicate& before) {
    return static_cast<std::size_t>(std::partition_point(frames.begin(), frames.end(), before) - frames.begin());
  }

  std::vector<std::shared_ptr<Block>> blocks_;
  std::vector<FrameRecord> newest_;  ///< behind the blocks; from `block_records` on, never fewer
};

}  // namespace chainslam
