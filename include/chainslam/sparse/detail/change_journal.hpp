#pragma once

#include <algorithm>
#include <cstdint>
#include <span>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam::detail {

enum class Change : std::uint8_t {
  variable_added,
  variable_fixed,  ///< or let go
  term_added,
  term_removed,
  term_numbers,  ///< with the numbers before
  node_removed,  ///< with its children; its numbers are given up
  node_created,
  node_numbers,   ///< computed anew in place
  node_solution,  ///< with its excess and the solution of its columns before
  solution,       ///< with a variable's solution before
};

/// What changed since a point in time and how it was before, so that it can be undone, last change first.
class ChangeJournal {
 public:
  struct Entry {
    Change change;
    Index id;
    Offset first;  ///< of its numbers or indices
    Offset count;
  };

  void clear() {
    entries_.clear();
    indices_.clear();
    if (numbers_.capacity() <= most_kept)
      numbers_.clear();
    else
      numbers_ = Table<double>();
  }
  /// For what is never undone: numbers are not copied from here on.
  void leave_numbers_out() { with_numbers_ = false; }

  void add(Change change, Index id) { entries_.push_back({change, id, 0, 0}); }
  void add_numbers(Change change, Index id, std::span<const double> numbers) {
    add(change, id);
    entries_.back().first = numbers_.size();
    append_numbers(numbers);
  }
  /// Adds to the last entry's numbers.
  void append_numbers(std::span<const double> numbers) {
    if (!with_numbers_) return;
    numbers_.append(numbers);
    entries_.back().count += static_cast<Offset>(numbers.size());
  }
  /// Starts an entry to which `push_index` adds.
  void add_indices(Change change, Index id) { entries_.push_back({change, id, indices_.size(), 0}); }
  void push_index(Index index) {
    indices_.push_back(index);
    ++entries_.back().count;
  }

  [[nodiscard]] const Table<Entry>& entries() const { return entries_; }
  [[nodiscard]] std::span<const double> numbers(const Entry& entry) const {
    return numbers_.range(entry.first, entry.first + entry.count);
  }
  [[nodiscard]] std::span<const Index> indices(const Entry& entry) const {
    return indices_.range(entry.first, entry.first + entry.count);
  }

 private:
  static constexpr Offset most_kept = 1 << 20;  ///< numbers that memory is kept for: not for those of a whole graph

  Table<Entry> entries_;
  Table<double> numbers_;
  Table<Index> indices_;
  bool with_numbers_ = true;
};

}  // namespace chainslam::detail
