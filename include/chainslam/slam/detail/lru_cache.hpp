#pragma once

#include <algorithm>
#include <cstddef>
#include <iterator>
#include <list>
#include <utility>

namespace chainslam::detail {

/// Values by key within a number of bytes; the least recently used go first.
///
/// Keys are found by a walk over all entries: meant for some hundred values that cost far more to make.
template <class Key, class Value>
class LruCache {
 public:
  /// Keeps values of so many bytes together, at most.
  explicit LruCache(std::size_t max_bytes) : max_bytes_(max_bytes) {}

  /// The value of `key`, which counts as used now; null if there is none. It stays where it is until it is erased.
  [[nodiscard]] Value* find(const Key& key) {
    const auto known = position(key);
    if (known == entries_.end()) return nullptr;
    entries_.splice(entries_.begin(), entries_, known);
    return &entries_.front().value;
  }

  /// Keeps a value, of a key that has none, and lets others go for it; the newest stays even if it alone is too large.
  Value& insert(const Key& key, Value value, std::size_t bytes) {
    entries_.push_front({key, std::move(value), bytes});
    bytes_ += bytes;
    while (bytes_ > max_bytes_ && entries_.size() > 1) erase(std::prev(entries_.end()));
    return entries_.front().value;
  }

  /// Drops the value of a key, if it has one.
  void erase(const Key& key) {
    const auto known = position(key);
    if (known != entries_.end()) erase(known);
  }

  /// The first value for which `condition(value)` holds; null if there is none. It does not count as used.
  template <class Condition>
  [[nodiscard]] Value* find_if(const Condition& condition) {
    const auto found =
        std::find_if(entries_.begin(), entries_.end(), [&](const Entry& entry) { return condition(entry.value); });
    return found == entries_.end() ? nullptr : &found->value;
  }

  [[nodiscard]] std::size_t bytes() const { return bytes_; }          ///< of all values kept, as they were stated
  [[nodiscard]] std::size_t size() const { return entries_.size(); }  ///< number of values

 private:
  struct Entry {
    Key key;
    Value value;
    std::size_t bytes = 0;
  };
  using Entries = std::list<Entry>;

  [[nodiscard]] typename Entries::iterator position(const Key& key) {
    return std::find_if(entries_.begin(), entries_.end(), [&](const Entry& entry) { return entry.key == key; });
  }

  void erase(typename Entries::iterator entry) {
    bytes_ -= entry->bytes;
    entries_.erase(entry);
  }

  std::size_t max_bytes_;
  Entries entries_;  // the most recently used first
  std::size_t bytes_ = 0;
};

}  // namespace chainslam::detail
