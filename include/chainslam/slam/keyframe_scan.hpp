#pragma once

#include <algorithm>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <list>
#include <memory>
#include <mutex>
#include <unordered_map>
#include <utility>

#include "chainslam/cloud/point_cloud.hpp"

namespace chainslam {

/// Scans that were read from sources, within a number of bytes; the least recently used go first. Sources may share
/// one; any thread may use it.
class ScanCache {
 public:
  /// Points of a scan.
  using Cloud = std::shared_ptr<const PointCloud<float>>;
  /// Some hundred scans: what loop closure around one place reads again and again.
  static constexpr std::size_t default_bytes = std::size_t{32} << 20;

  /// Keeps so many bytes of points, but always the scan used last.
  explicit ScanCache(std::size_t max_bytes = default_bytes) : max_bytes_(max_bytes) {}
  ScanCache(const ScanCache&) = delete;
  ScanCache& operator=(const ScanCache&) = delete;

  /// A number for a new source, by which its scans are known here.
  [[nodiscard]] std::uint64_t add_source() {
    const std::scoped_lock lock(mutex_);
    return sources_++;
  }
  /// Drops all scans of a source, which is no more.
  void drop_source(std::uint64_t source) {
    Entries dropped;  // destroyed outside the lock
    const std::scoped_lock lock(mutex_);
    for (auto entry = entries_.begin(); entry != entries_.end();) {
      const auto next = std::next(entry);
      if (entry->key.source == source) take_out(entry, dropped);
      entry = next;
    }
  }

  /// The scan, which counts as used now; null if it is not here.
  [[nodiscard]] Cloud find(std::uint64_t source, std::size_t number) {
    const std::scoped_lock lock(mutex_);
    const auto known = by_key_.find({source, number});
    if (known == by_key_.end()) return nullptr;
    entries_.splice(entries_.begin(), entries_, known->second);
    return entries_.front().cloud;
  }

  /// Keeps a scan, and lets others go for it.
  /// @returns the one kept: another thread may have brought it first.
  Cloud keep(std::uint64_t source, std::size_t number, Cloud cloud) {
    const std::size_t bytes = bytes_of(*cloud);
    Entries dropped;  // destroyed outside the lock
    const std::scoped_lock lock(mutex_);
    if (const auto known = by_key_.find({source, number}); known != by_key_.end()) return known->second->cloud;
    entries_.push_front({{source, number}, std::move(cloud), bytes});
    by_key_.emplace(entries_.front().key, entries_.begin());
    bytes_ += bytes;
    while (bytes_ > max_bytes_ && entries_.size() > 1) take_out(std::prev(entries_.end()), dropped);
    return entries_.front().cloud;
  }

  /// Bytes of all points kept.
  [[nodiscard]] std::size_t bytes() const {
    const std::scoped_lock lock(mutex_);
    return bytes_;
  }
  /// Scans kept.
  [[nodiscard]] std::size_t size() const {
    const std::scoped_lock lock(mutex_);
    return entries_.size();
  }

  /// Bytes that a scan takes in memory.
  [[nodiscard]] static std::size_t bytes_of(const PointCloud<float>& cloud) {
    constexpr std::size_t vector_bytes = sizeof(float) * 3, record_bytes = 256;  // what keeping any scan takes
    return record_bytes + vector_bytes * (cloud.positions.capacity() + cloud.normals.capacity()) +
           sizeof(float) * (cloud.time_offsets.capacity() + cloud.intensities.capacity());
  }

 private:
  struct Key {
    std::uint64_t source;
    std::size_t number;
    friend bool operator==(const Key&, const Key&) = default;
  };
  struct KeyHash {
    std::size_t operator()(const Key& key) const { return key.number * 0x9e37'79b9'7f4a'7c15U + key.source; }
  };
  struct Entry {
    Key key;
    Cloud cloud;
    std::size_t bytes;
  };
  using Entries = std::list<Entry>;

  void take_out(Entries::iterator entry, Entries& out) {
    bytes_ -= entry->bytes;
    by_key_.erase(entry->key);
    out.splice(out.begin(), entries_, entry);
  }

  const std::size_t max_bytes_;
  mutable std::mutex mutex_;  ///< of all below
  Entries entries_;           ///< the most recently used first
  std::unordered_map<Key, Entries::iterator, KeyHash> by_key_;
  std::size_t bytes_ = 0;
  std::uint64_t sources_ = 0;
};

/// Where scans can be read again, bit for bit: a map's file, for instance. Any number of threads may read at once.
class ScanSource {
 public:
  virtual ~ScanSource() = default;
  /// Scan `number` of this source.
  /// @throws IoError if it cannot be read any more.
  [[nodiscard]] virtual std::shared_ptr<const PointCloud<float>> load(std::size_t number) const = 0;
};

/// A keyframe's scan: kept in memory, or read from where it is stored when it is asked for.
///
/// Copies are the same scan. Its points never change; where they are kept may (`keep_in`), also while other threads
/// read them.
class KeyframeScan {
 public:
  /// The points, for as long as somebody holds them.
  using Cloud = std::shared_ptr<const PointCloud<float>>;

  /// No scan.
  KeyframeScan() = default;
  /// A scan in memory; none if the pointer is null.
  template <std::convertible_to<Cloud> Pointer>
  KeyframeScan(Pointer cloud) {  // NOLINT: clouds are scans
    Cloud points = std::move(cloud);
    if (!points) return;
    const std::size_t size = points->size();
    state_ = std::make_shared<State>(std::move(points), nullptr, std::size_t{0}, size);
  }
  /// Scan `number` of a source, which has `size` points.
  KeyframeScan(std::shared_ptr<const ScanSource> source, std::size_t number, std::size_t size)
      : state_(std::make_shared<State>(nullptr, std::move(source), number, size)) {}

  /// Whether there is a scan.
  explicit operator bool() const { return state_ != nullptr; }
  /// Its points, which are not read for that; 0 without a scan.
  [[nodiscard]] std::size_t size() const { return state_ ? state_->size : 0; }

  /// The points, read from the source if they are not in memory; null without a scan.
  /// @throws IoError if they cannot be read any more.
  [[nodiscard]] Cloud load() const {
    if (!state_) return nullptr;
    const Place place = this->place();
    return place.cloud ? place.cloud : place.source->load(place.number);
  }

  /// Drops this handle's scan.
  void reset() { state_.reset(); }

  /// Where a scan is kept: its points, or the source that has them and its number there.
  struct Place {
    Cloud cloud{};                               ///< null if it is not in memory
    std::shared_ptr<const ScanSource> source{};  ///< null if it is in memory
    std::size_t number = 0;                      ///< in the source
  };
  /// Where it is kept now; all empty without a scan.
  [[nodiscard]] Place place() const {
    if (!state_) return {};
    const std::scoped_lock lock(state_->mutex);
    return {state_->cloud, state_->source, state_->number};
  }

  /// From now on this scan and all copies of it are read from a source that has the same points; the copy in memory
  /// goes when nobody holds it any more.
  void keep_in(std::shared_ptr<const ScanSource> source, std::size_t number) const {
    if (!state_) return;
    Cloud released;  // outside the lock
    const std::scoped_lock lock(state_->mutex);
    released.swap(state_->cloud);
    state_->source = std::move(source);
    state_->number = number;
  }

  /// Whether both are copies of one scan, or both none.
  friend bool operator==(const KeyframeScan&, const KeyframeScan&) = default;

 private:
  struct State {
    State(Cloud points, std::shared_ptr<const ScanSource> from, std::size_t place, std::size_t count)
        : size(count), cloud(std::move(points)), source(std::move(from)), number(place) {}

    const std::size_t size;
    mutable std::mutex mutex;  ///< of all below
    Cloud cloud;
    std::shared_ptr<const ScanSource> source;
    std::size_t number;
  };

  std::shared_ptr<State> state_;
};

}  // namespace chainslam
