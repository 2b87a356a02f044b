#pragma once

#include <algorithm>
#include <limits>
#include <span>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sparse/block_matrix.hpp"

namespace chainslam::detail {

/// The variables nearest to one in the graph whose edges are terms.
template <int B>
class NearVariables {
 public:
  static constexpr Index beyond = std::numeric_limits<Index>::max();

  /// Lists up to `count` of `size` variables, `from` first, by breadth-first search.
  void list(const BlockTerms<B>& terms, Index size, Index from, Index count) {
    clear();
    rank_.resize(size, beyond);
    const auto reach = [&](Index variable) {
      if (rank_[variable] != beyond || near_.size() >= count) return;
      rank_[variable] = to_index(near_.size());
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
    for (const Index variable : near_) rank_[variable] = beyond;
    near_.clear();
  }

  [[nodiscard]] bool empty() const { return near_.empty(); }
  /// How many are nearer than a variable; `beyond` where it is not listed.
  [[nodiscard]] Index rank(Index variable) const { return rank_[variable]; }
  /// Up to `count` of them, the nearest first.
  [[nodiscard]] std::span<const Index> nearest(Index count) const {
    return near_.range(0, std::min(Offset{count}, near_.size()));
  }

 private:
  Table<Index> near_;
  Table<Index> rank_;  ///< of each variable
};

}  // namespace chainslam::detail
