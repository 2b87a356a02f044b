#pragma once

#include <array>

#include "chainslam/core/byte_archive.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam::detail {

/// Variables that wait for something, in order of arrival. What came and went since `begin` can be undone, at the cost
/// of that alone: in large graphs with patience, many wait.
class WaitingList {
 public:
  void add_variable() { place_.push_back(-1); }
  void drop_last_variable() { place_.pop_back(); }

  [[nodiscard]] bool waits(Index key) const { return place_[key] != -1; }
  [[nodiscard]] Index count() const { return to_index(keys_.size()) - left_; }  ///< how many wait
  /// All that wait, and -1 in the places of those that did.
  [[nodiscard]] const Table<Index>& keys() const { return keys_; }

  /// To be called for one that does not wait.
  void wait(Index key) {
    place_[key] = to_index(keys_.size());
    keys_.push_back(key);
  }
  void stop(Index key) {
    const Index place = place_[key];
    if (place == -1) return;
    if (place < size_before_) stopped_.append(std::array{place, key});
    keys_[place] = -1;
    place_[key] = -1;
    ++left_;
  }

  /// From here on, changes can be undone; those before no longer.
  void begin() {
    if (2 * left_ > to_index(keys_.size())) close_gaps();
    size_before_ = to_index(keys_.size());
    left_before_ = left_;
    stopped_.clear();
  }
  /// Makes it as it was at `begin`; variables that came since are still known.
  void undo() {
    for (Offset k = size_before_; k < keys_.size(); ++k) {
      if (keys_[k] != -1) place_[keys_[k]] = -1;
    }
    keys_.resize(size_before_);
    for (Offset k = 0; k < stopped_.size(); k += 2) {
      keys_[stopped_[k]] = stopped_[k + 1];
      place_[stopped_[k + 1]] = stopped_[k];
    }
    left_ = left_before_;
    stopped_.clear();
  }

  void save(ByteSink& out) const {
    WaitingList saved = *this;
    saved.close_gaps();
    out.put_list(saved.keys_);
  }
  /// @param size  number of variables.
  void load(ByteSource& in, Index size) {
    *this = {};
    in.take_list(keys_);
    place_.assign(size, -1);
    close_gaps();
    begin();
  }

 private:
  void close_gaps() {
    keys_.keep_if([](Index key) { return key != -1; });
    left_ = 0;
    for (Index k = 0; k < to_index(keys_.size()); ++k) place_[keys_[k]] = k;
  }

  Table<Index> place_;  ///< of each variable in `keys_`, -1 if it does not wait
  Table<Index> keys_;
  Index left_ = 0;  ///< how many of those are -1
  Index size_before_ = 0;
  Index left_before_ = 0;
  Table<Index> stopped_;  ///< places and keys of those that waited at `begin` and no longer do
};

}  // namespace chainslam::detail
