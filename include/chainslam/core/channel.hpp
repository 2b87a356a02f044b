#pragma once

#include <condition_variable>
#include <cstddef>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <stdexcept>
#include <stop_token>
#include <utility>

namespace chainslam {

/// A bounded queue between two stages of a pipeline. Any number of threads may push and pop.
///
/// Soft end: the writer calls `close()`, the reader drains what is left and then gets nothing. Hard end: a stop request
/// wakes whoever waits, and what is left stays in the queue.
template <class T>
class Channel {
 public:
  /// @throws std::invalid_argument if `capacity` is 0: no item could ever pass.
  explicit Channel(std::size_t capacity) : capacity_(capacity) {
    if (capacity == 0) throw std::invalid_argument("Channel: capacity must be at least 1");
  }

  Channel(const Channel&) = delete;
  Channel& operator=(const Channel&) = delete;

  /// Waits for capacity, then adds the item.
  /// @returns false, with the item untouched, if the channel is closed or `stop` is requested.
  [[nodiscard]] bool push(T&& item, const std::stop_token& stop = {}) {
    std::unique_lock lock(mutex_);
    room_or_closed_.wait(lock, stop, [this] { return closed_ || items_.size() < capacity_; });
    return !stop.stop_requested() && add(std::move(item));
  }

  /// Adds the item if there is capacity now.
  /// @returns false, with the item untouched, if the channel is full or closed: a live source counts what it drops.
  [[nodiscard]] bool try_push(T&& item) {
    const std::scoped_lock lock(mutex_);
    return items_.size() < capacity_ && add(std::move(item));
  }

  /// Waits for an item.
  /// @returns nothing if the channel is closed and empty, or `stop` is requested.
  [[nodiscard]] std::optional<T> pop(const std::stop_token& stop = {}) {
    std::unique_lock lock(mutex_);
    item_or_closed_.wait(lock, stop, [this] { return closed_ || !items_.empty(); });
    if (stop.stop_requested() || items_.empty()) return std::nullopt;
    std::optional<T> item(std::move(items_.front()));
    items_.pop_front();
    room_or_closed_.notify_one();
    return item;
  }

  /// No item is taken any more; those inside can still be popped.
  void close() {
    const std::scoped_lock lock(mutex_);
    closed_ = true;
    room_or_closed_.notify_all();
    item_or_closed_.notify_all();
  }

  /// Whether `close` was called.
  [[nodiscard]] bool closed() const {
    const std::scoped_lock lock(mutex_);
    return closed_;
  }

  /// Items that wait to be popped.
  [[nodiscard]] std::size_t size() const {
    const std::scoped_lock lock(mutex_);
    return items_.size();
  }

  [[nodiscard]] std::size_t capacity() const { return capacity_; }  ///< largest number of items that wait

 private:
  bool add(T&& item) {
    if (closed_) return false;
    items_.push_back(std::move(item));
    item_or_closed_.notify_one();
    return true;
  }

  const std::size_t capacity_;
  mutable std::mutex mutex_;
  std::condition_variable_any room_or_closed_;
  std::condition_variable_any item_or_closed_;
  std::deque<T> items_;
  bool closed_ = false;
};

/// The latest state of something that one thread writes and others read: a state is never changed, only replaced, and a
/// reader keeps the one it has for as long as it likes.
///
/// A mutex around a `shared_ptr`, since libstdc++ 12's `std::atomic<std::shared_ptr>` is a data race to
/// ThreadSanitizer.
template <class T>
class Snapshot {
 public:
  Snapshot() = default;
  explicit Snapshot(std::shared_ptr<const T> state) : state_(std::move(state)) {}  ///< starts with this state

  /// The latest state, or null if none has been stored.
  [[nodiscard]] std::shared_ptr<const T> load() const {
    const std::scoped_lock lock(mutex_);
    return state_;
  }

  /// Replaces the state. What was there is released outside the lock, so that readers never wait for a destructor.
  void store(std::shared_ptr<const T> state) {
    const std::scoped_lock lock(mutex_);
    state_.swap(state);
  }

 private:
  mutable std::mutex mutex_;
  std::shared_ptr<const T> state_;
};

}  // namespace chainslam
