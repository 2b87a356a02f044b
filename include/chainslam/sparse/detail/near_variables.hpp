#pragma once

#include <algorithm>
#include <span>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sparse/block_matrix.hpp"

namespace chainslam::detail {

/// The variables nearest to one in the graph whose edges are terms.
template <int B>
class NearVariables {
 public:
  /// Lists up to `count` of `size` variables, `from` first, by breadth-first search.
  void list(const BlockTerms<B>& terms, Index size, Index from, Index count) {
    clear();
    listed_.resize(size, 0);
    const auto reach = [&](Index variable) {
      if (contains(variable) || near_.size() >= count) return;
      listed_[variable] = 1;
      near_.push_back(variable);
    };
    reach(from);
    for (Offset k = 0; k < near_.size() && near_.size() < count; ++k) {
      for (Index s = terms.first(near_[k]); s != -1; s = terms.slot(s).next) {
        for (const auto& slot : terms.slots(terms.slot(s).term)) reach(slot.variable);
      }
    }
  }

  void clear() {
    for (const Index variable : near_) listed_[variable] = 0;
    near_.clear();
  }

  [[nodiscard]] bool empty() const { return near_.empty(); }
  [[nodiscard]] bool contains(Index variable) const { return listed_[variable] != 0; }
  /// Up to `count` of them, the nearest first.
  [[nodiscard]] std::span<const Index> nearest(Index count) const {
    return near_.range(0, std::min(Offset{count}, near_.size()));
  }

 private:
  Table<Index> near_;
  Table<char> listed_;  ///< of each variable: whether it is one of them
};

}  // namespace chainslam::detail
