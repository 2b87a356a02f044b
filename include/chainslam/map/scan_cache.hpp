#pragma once

#include <algorithm>
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

}  // namespace chainslam
