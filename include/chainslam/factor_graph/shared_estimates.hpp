#pragma once

#include <cassert>
#include <cstdint>
#include <mutex>
#include <span>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/values.hpp"

namespace chainslam {

/// A smoother's estimates for other threads, which read them while an update runs: those of the last one published.
///
/// One thread publishes, any read. Publishing writes what an update has changed, and holds readers up only for that;
/// what is read in one call is of one update.
template <class Group>
class SharedEstimates {
 public:
  /// Takes the smoother's estimates over. After one update costs what that has changed; after several, or what is not
  /// an update, all are copied.
  template <class Smoother>
  void publish(const Smoother& smoother) {
    const std::uint64_t revision = smoother.revision();
    if (revision == revision_) return;
    if (revision != revision_ + 1) {
      Values<Group> all = smoother.values();
      const std::scoped_lock lock(mutex_);
      values_ = std::move(all);
    } else {
      const std::scoped_lock lock(mutex_);
      for (Key key = values_.size(); key < smoother.size(); ++key) values_.add(smoother[key]);
      for (const Key key : smoother.changed()) values_[key] = smoother[key];
    }
    revision_ = revision;
  }

  /// Number of estimates.
  [[nodiscard]] Index size() const {
    const std::scoped_lock lock(mutex_);
    return values_.size();
  }
  /// @param key  less than some earlier `size()`.
  [[nodiscard]] Group operator[](Key key) const {
    const std::scoped_lock lock(mutex_);
    return values_[key];
  }
  /// Some estimates of one update.
  [[nodiscard]] std::vector<Group> read(std::span<const Key> keys) const {
    std::vector<Group> found;
    found.reserve(keys.size());
    const std::scoped_lock lock(mutex_);
    for (const Key key : keys) found.push_back(values_[key]);
    return found;
  }
  /// All estimates of one update.
  [[nodiscard]] Values<Group> values() const {
    const std::scoped_lock lock(mutex_);
    return values_;
  }

 private:
  mutable std::mutex mutex_;
  Values<Group> values_;
  std::uint64_t revision_ = 0;  ///< of the publishing thread alone
};

}  // namespace chainslam
