#pragma once

#include <algorithm>
#include <span>

#include "chainslam/core/types.hpp"

namespace chainslam {

/// A thing by its number, and what it is sorted by.
struct Ranked {
  double rank = 0;  ///< what it is sorted by
  Index index = 0;  ///< what it stands for

  /// By rank, then by index.
  [[nodiscard]] bool operator<(const Ranked& other) const {
    return rank != other.rank ? rank < other.rank : index < other.index;
  }
};

/// The least rank first, equal ones by index. Whatever is sorted, the sort is compiled once.
[[gnu::noinline]] inline void sort_ranked(std::span<Ranked> all) { std::sort(all.data(), all.data() + all.size()); }

}  // namespace chainslam
