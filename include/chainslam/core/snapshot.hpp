#pragma once

#include <memory>
#include <mutex>
#include <utility>

namespace chainslam {

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
