#pragma once

#include <algorithm>

#include "chainslam/sparse/detail/incremental_cholesky_class.hpp"

// How `IncrementalCholesky` takes changes back.

namespace chainslam {

/// What was computed in place, or given up, is computed again from what it came from, in the same order: to the same
/// bits.
template <int BlockSize>
void IncrementalCholesky<BlockSize>::rollback() {
  clear_changes();
  recomputed_.clear();
  restored_.clear();
  for (Offset k = journal_.entries().size() - 1; k >= 0; --k) undo(journal_.entries()[k]);
  journal_.clear();
  const auto for_each_due = [&](auto&& visit) {
    for (Offset k = recomputed_.size() - 1; k >= 0; --k) {
      if (tree_.has_numbers(recomputed_[k])) visit(recomputed_[k]);
    }
    for (const Index node : restored_) {
      if (tree_.has_numbers(node)) visit(node);
    }
  };
  for_each_due([&](Index node) {
    for (Index child = tree_[node].first_child; child != -1; child = tree_[child].next) {
      if (!tree_.has_update(child)) stack_.push_back(child);
    }
  });
  list_below(recalled_, [&](Index child) { return !tree_.has_update(child); });
  for (const Index node : recalled_) static_cast<void>(compute(node));
  for (Offset k = recomputed_.size() - 1; k >= 0; --k) {
    if (tree_.has_numbers(recomputed_[k])) static_cast<void>(compute(recomputed_[k]));
  }
  compute_restored();
  totals_ = totals_before_;
  for (const Index node : recalled_) forget_updates(node);
  for_each_due([&](Index node) { forget_updates(node); });
}

/// Children before parents; all above a restored node is restored, too.
template <int BlockSize>
void IncrementalCholesky<BlockSize>::compute_restored() {
  ready_.clear();
  for (const Index node : restored_) {
    if (tree_.has_numbers(node) && tree_[node].parent != -1) ++tree_[tree_[node].parent].waits_for;
  }
  for (const Index node : restored_) {
    if (tree_.has_numbers(node) && tree_[node].waits_for == 0) ready_.push_back(node);
  }
  for (Offset k = 0; k < ready_.size(); ++k) {
    static_cast<void>(compute(ready_[k]));
    const Index parent = tree_[ready_[k]].parent;
    if (parent != -1 && --tree_[parent].waits_for == 0) ready_.push_back(parent);
  }
}

template <int BlockSize>
void IncrementalCholesky<BlockSize>::undo(const Journal::Entry& entry) {
  const std::span<const double> numbers = journal_.numbers(entry);
  switch (entry.change) {
    case detail::Change::variable_added:
      fixed_.pop_back();
      local_.pop_back();
      assembly_.drop_last_variable();
      solution_.resize(solution_.size() - BlockSize);
      terms_.drop_last_variable();
      tree_.drop_last_variable();
      break;
    case detail::Change::variable_fixed:
      fixed_[entry.id] = fixed_[entry.id] == 0 ? 1 : 0;
      break;
    case detail::Change::term_added:
      terms_.unlink(entry.id);
      terms_.release(entry.id);
      break;
    case detail::Change::term_removed:
      terms_.relink(entry.id);
      terms_.set_counted(entry.id, true);
      break;
    case detail::Change::term_numbers:
      std::copy(numbers.begin(), numbers.end(), terms_.jacobian(entry.id));
      terms_.set_counted(entry.id, true);
      break;
    case detail::Change::node_removed:
      tree_.take_numbers(entry.id);
      restored_.push_back(entry.id);
      tree_.drop_children(entry.id);
      for (const Index child : journal_.indices(entry)) tree_.append_child(entry.id, child);
      for (const Index variable : tree_.columns(entry.id)) tree_.set_node_of(variable, entry.id);
      break;
    case detail::Change::node_created:
      for (const Index variable : tree_.columns(entry.id)) tree_.set_node_of(variable, -1);
      tree_.release(entry.id);
      break;
    case detail::Change::node_numbers:
      recomputed_.push_back(entry.id);
      break;
    case detail::Change::node_solution: {
      tree_[entry.id].excess = numbers[0];
      if (numbers.size() == 1) break;
      const double* from = numbers.data() + 1;
      for (const Index variable : tree_.columns(entry.id)) {
        std::copy_n(from, BlockSize, solution_.data() + Offset{variable} * BlockSize);
        from += BlockSize;
      }
      break;
    }
    case detail::Change::solution:
      std::copy(numbers.begin(), numbers.end(), solution_.data() + Offset{entry.id} * BlockSize);
      break;
  }
}

}  // namespace chainslam
