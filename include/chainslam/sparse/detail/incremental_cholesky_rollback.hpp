#pragma once

#include <algorithm>

#include "chainslam/core/byte_archive.hpp"
#include "chainslam/sparse/incremental_cholesky.hpp"

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
  surroundings_.rollback();
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

/// What waits to be given up when changes begin is saved as if they had begun. The fronts' numbers are not saved.
template <int BlockSize>
void IncrementalCholesky<BlockSize>::save(ByteSink& out) const {
  std::vector<Index> removed_terms, removed_nodes;
  for (const Journal::Entry& entry : journal_.entries()) {
    if (entry.change == detail::Change::term_removed) removed_terms.push_back(entry.id);
    if (entry.change == detail::Change::node_removed) removed_nodes.push_back(entry.id);
  }
  out.put_list(fixed_);
  out.put_list(solution_);
  out.put_list(changed_);
  out.put(totals_.squared_residuals);
  out.put(totals_.lowered);
  out.put(totals_.excess);
  out.put(totals_.multiplications);
  out.put(totals_.factorizations);
  out.put(totals_.nodes);
  terms_.save(out, removed_terms);
  tree_.save(out, removed_nodes);
  surroundings_.save(out);
}

/// Computes the fronts' numbers again from what they came from, in the same order: to the same bits.
template <int BlockSize>
void IncrementalCholesky<BlockSize>::load(ByteSource& in) {
  *this = IncrementalCholesky(options_);
  in.take_list(fixed_);
  in.take_list(solution_);
  in.take_list(changed_);
  Totals totals;
  totals.squared_residuals = in.take<double>();
  totals.lowered = in.take<double>();
  totals.excess = in.take<double>();
  totals.multiplications = in.take<double>();
  totals.factorizations = in.take<Index>();
  totals.nodes = in.take<Index>();
  terms_.load(in);
  const std::vector<Index> without_update = tree_.load(in);
  surroundings_.load(in);
  for (Index variable = 0; variable < size(); ++variable) {
    local_.push_back(-1);
    assembly_.add_variable();
  }
  for (Index node = 0; node < tree_.size(); ++node) {
    if (tree_.has_numbers(node)) restored_.push_back(node);
  }
  compute_restored();
  for (const Index node : without_update) tree_.release_update(node);
  work_ = {};
  totals_ = totals_before_ = totals;
}

}  // namespace chainslam
