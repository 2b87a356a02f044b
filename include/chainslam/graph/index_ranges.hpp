#pragma once

#include <algorithm>
#include <cstddef>
#include <iterator>
#include <optional>
#include <span>
#include <stdexcept>
#include <vector>

#include "chainslam/core/types.hpp"

namespace chainslam {

/// The indices first .. end - 1.
struct IndexRange {
  Index first = 0;  ///< the first index
  Index end = 0;    ///< behind the last index

  [[nodiscard]] constexpr Index size() const { return end - first; }   ///< number of indices
  [[nodiscard]] constexpr bool empty() const { return end == first; }  ///< whether there is nothing in it
  /// Whether the index is in it.
  [[nodiscard]] constexpr bool contains(Index index) const { return first <= index && index < end; }
  friend constexpr bool operator==(IndexRange, IndexRange) = default;  ///< whether all members are equal
};

/// Ascending ranges that do not overlap, such as the keyframes of one session after another; the last one may grow.
/// Ranges may be empty, and there may be gaps between them.
class IndexRanges {
 public:
  /// Adds a range after all others. @returns its number.
  /// @throws std::invalid_argument if it begins before the last one's end or below 0, or ends before it begins.
  Index add(IndexRange range) {
    const Index free = ranges_.empty() ? 0 : ranges_.back().end;
    if (range.first < free || range.end < range.first)
      throw std::invalid_argument("IndexRanges: ranges must ascend and must not overlap");
    const Index number = to_index(ranges_.size(), "IndexRanges");
    ranges_.push_back(range);
    return number;
  }

  /// Lets the last range reach to `end`.
  /// @throws std::invalid_argument if there is none, or if it would become shorter.
  void extend(Index end) {
    if (ranges_.empty() || end < ranges_.back().end)
      throw std::invalid_argument("IndexRanges: only the last range grows, and never shrinks");
    ranges_.back().end = end;
  }

  [[nodiscard]] Index size() const { return static_cast<Index>(ranges_.size()); }  ///< number of ranges
  /// A range by its number.
  [[nodiscard]] IndexRange operator[](Index number) const { return ranges_[static_cast<std::size_t>(number)]; }
  [[nodiscard]] std::span<const IndexRange> all() const { return ranges_; }  ///< all ranges

  /// The number of the range that contains the index; O(log ranges).
  [[nodiscard]] std::optional<Index> range_of(Index index) const {
    // Only the last range that begins at or before the index can hold it: those before end where it begins or earlier.
    const auto after = std::upper_bound(ranges_.begin(), ranges_.end(), index,
                                        [](Index i, const IndexRange& range) { return i < range.first; });
    if (after == ranges_.begin() || !std::prev(after)->contains(index)) return std::nullopt;
    return static_cast<Index>(after - ranges_.begin() - 1);
  }

 private:
  std::vector<IndexRange> ranges_;
};

}  // namespace chainslam
