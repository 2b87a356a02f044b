#pragma once

#include "chainslam/core/byte_archive.hpp"
#include "chainslam/sparse/detail/incremental_cholesky_class.hpp"

// How `IncrementalCholesky` is saved and loaded.

namespace chainslam {

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
