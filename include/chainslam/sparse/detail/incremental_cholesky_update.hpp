#pragma once

#include "chainslam/sparse/detail/incremental_cholesky_class.hpp"

// How `IncrementalCholesky` brings factor and solution up to date.

namespace chainslam {

template <int BlockSize>
FactorizationResult IncrementalCholesky<BlockSize>::factorize() {
  for (const Index term : written_) {
    if (!terms_.linked(term) || terms_.counted(term)) continue;
    totals_.squared_residuals += terms_.squared_residual(term);
    terms_.set_counted(term, true);
  }
  written_.clear();
  for (const Index variable : reordered_) mark(tree_.node_of(variable), detail::Stale::order);
  promote_heavy();
  collect_affected();
  FactorizationResult result = refresh_nodes();
  if (result.ok() && affected_.size() > 0) result = eliminate_affected();
  for (const Index variable : affected_) local_[variable] = -1;
  return result;
}

template <int BlockSize>
void IncrementalCholesky<BlockSize>::solve(bool exact) {
  changed_.clear();
  const double error = std::max(squared_error(), options_.least_error);
  // A hundredth for each node, so that many may keep theirs before the share is used up.
  tolerated_ = exact ? 0.0 : std::max(0.0, options_.relative_excess * error - totals_.excess) / 100.0;
  for (const Index node : fresh_) {
    if (tree_[node].parent == -1) stack_.push_back(node);
  }
  for (const Index node : stale_) {
    if (tree_[node].parent == -1 && tree_[node].stale != Stale::order) stack_.push_back(node);
  }
  while (stack_.size() > 0) {
    const Index node = stack_.back();
    stack_.pop_back();
    substitute(node);
    for (Index child = tree_[node].first_child; child != -1; child = tree_[child].next) {
      if (tree_[child].stale == Stale::none && !any_moved(tree_.rows(child))) continue;
      __builtin_prefetch(tree_[child].data);
      __builtin_prefetch(tree_[child].variables);
      stack_.push_back(child);
    }
  }
  for (const Index variable : changed_) local_[variable] = -1;
  clear_changes();
}

template <int BlockSize>
void IncrementalCholesky<BlockSize>::promote_heavy() {
  double work = 0.0, columns = 1.0;
  for (const Index node : stale_) {
    if (tree_[node].stale != Stale::numbers) continue;
    work += Front::work(tree_[node].columns, tree_[node].rows);
    columns += tree_[node].columns;
  }
  if (work < options_.reorder_work * columns) return;
  for (Offset k = 0; k < stale_.size(); ++k) {
    if (tree_[stale_[k]].stale == Stale::numbers) mark(stale_[k], Stale::order);
  }
}

template <int BlockSize>
void IncrementalCholesky<BlockSize>::collect_affected() {
  affected_.clear();
  orphans_.clear();
  for (const Index variable : reordered_) affect(variable);
  for (const Index node : stale_) {
    if (tree_[node].stale != Stale::order) continue;
    journal_.add_indices(detail::Change::node_removed, node);
    totals_.lowered -= tree_[node].lowered;
    totals_.excess -= tree_[node].excess;
    --totals_.nodes;
    for (Index child = tree_[node].first_child; child != -1; child = tree_[child].next) {
      journal_.push_index(child);
      if (tree_[child].stale != Stale::order) orphans_.push_back(child);
    }
    for (const Index variable : tree_.columns(node)) affect(variable);
    tree_.release_numbers(node);
  }
  std::sort(affected_.begin(), affected_.end());
  for (Index k = 0; k < to_index(affected_.size()); ++k) local_[affected_[k]] = k;
}

template <int BlockSize>
FactorizationResult IncrementalCholesky<BlockSize>::refresh_nodes() {
  for (const Index node : stale_) {
    if (tree_[node].stale != Stale::order && tree_[node].parent != -1) ++tree_[tree_[node].parent].waits_for;
  }
  ready_.clear();
  for (const Index node : stale_) {
    if (tree_[node].stale != Stale::order && tree_[node].waits_for == 0) ready_.push_back(node);
  }
  FactorizationResult result;
  for (Offset k = 0; k < ready_.size(); ++k) {
    const Index node = ready_[k];
    if (result.ok()) {
      journal_.add(detail::Change::node_numbers, node);
      result = compute(node);
    }
    const Index parent = tree_[node].parent;
    if (parent != -1 && --tree_[parent].waits_for == 0 && tree_[parent].stale != Stale::order) ready_.push_back(parent);
  }
  return result;
}

template <int BlockSize>
FactorizationResult IncrementalCholesky<BlockSize>::eliminate_affected() {
  plan_.begin(to_index(affected_.size()));
  for (Index k = 0; k < to_index(affected_.size()); ++k) {
    for (Index s = terms_.first(affected_[k]); s != -1; s = terms_.slot(s).next) {
      for (const auto& other : terms_.slots(terms_.slot(s).term)) {
        if (local_[other.variable] > k) plan_.add_edge(k, local_[other.variable]);
      }
    }
  }
  for (const Index orphan : orphans_) {
    for (const Index row : tree_.rows(orphan)) plan_.add_to_element(local_[row]);
    plan_.end_element();
  }
  const auto late = std::lower_bound(affected_.begin(), affected_.end(), size() - options_.late_variables);
  plan_.plan(static_cast<Index>(late - affected_.begin()), BlockSize);
  work_.reordered += to_index(affected_.size());
  create_nodes();
  for (const Index node : fresh_) {
    const FactorizationResult result = compute(node);
    if (!result.ok()) return result;
  }
  return {};
}

template <int BlockSize>
void IncrementalCholesky<BlockSize>::create_nodes() {
  for (Index f = 0; f < plan_.fronts(); ++f) {
    const auto& front = plan_.front(f);
    const Index node = tree_.create(front.columns, front.rows);
    journal_.add(detail::Change::node_created, node);
    tree_[node].stale = Stale::numbers;
    ++totals_.nodes;
    fresh_.push_back(node);
    Index* variable = tree_[node].variables;
    for (const Index column : plan_.columns(front)) {
      tree_.set_node_of(affected_[column], node);
      *variable++ = affected_[column];
    }
    for (const Index row : plan_.rows(front)) *variable++ = affected_[row];
  }
  for (Index f = 0; f < plan_.fronts(); ++f) {
    if (plan_.front(f).parent != -1) tree_.append_child(fresh_[plan_.front(f).parent], fresh_[f]);
  }
  for (Index e = 0; e < to_index(orphans_.size()); ++e)
    tree_.append_child(fresh_[plan_.front_of_element(e)], orphans_[e]);
}

template <int BlockSize>
FactorizationResult IncrementalCholesky<BlockSize>::compute(Index node) {
  assembly_.assemble(tree_, terms_, fixed_, node);
  const Front front = tree_.front(node);
  work_.refactorized += front.columns();
  work_.multiplications += Front::work(front.columns(), front.rows());
  const Index bad = front.eliminate(options_.pivot_tolerance);
  if (bad != -1)
    return {FactorizationStatus::not_positive_definite, tree_.columns(node)[static_cast<std::size_t>(bad)]};
  front.substitute_forward(front.right());
  totals_.lowered -= tree_[node].lowered;
  tree_[node].lowered = 0.0;
  for (Offset k = 0; k < Offset{front.columns()} * BlockSize; ++k)
    tree_[node].lowered += front.right()[k] * front.right()[k];
  totals_.lowered += tree_[node].lowered;
  return {};
}

template <int BlockSize>
void IncrementalCholesky<BlockSize>::substitute(Index node) {
  const Front front = tree_.front(node);
  const std::span<const Index> variables = tree_.variables(node);
  const auto columns = static_cast<std::size_t>(front.columns());
  const Offset own = Offset{front.columns()} * BlockSize;
  work_.substituted += front.columns();
  gathered_.resize(front.stride() + own);
  double* const x = gathered_.data();
  double* const old = x + front.stride();
  std::copy_n(front.right(), own, x);
  for (std::size_t k = 0; k < variables.size(); ++k)
    std::copy_n(solution(variables[k]).data(), BlockSize, (k < columns ? old : x) + static_cast<Offset>(k) * BlockSize);
  front.subtract_rows(x);
  const double excess = front.excess(x, old);
  const bool kept = excess <= tolerated_;
  const double excess_before = tree_[node].excess;
  totals_.excess += (kept ? excess : 0.0) - excess_before;
  tree_[node].excess = kept ? excess : 0.0;
  journal_.add_numbers(detail::Change::node_solution, node, {&excess_before, 1});
  if (kept) return;
  journal_.append_numbers({old, static_cast<std::size_t>(own)});
  front.solve_columns(x);
  for (std::size_t k = 0; k < columns; ++k) {
    const Index variable = variables[k];
    std::copy_n(x + static_cast<Offset>(k) * BlockSize, BlockSize, solution_.data() + Offset{variable} * BlockSize);
    changed_.push_back(variable);
    local_[variable] = 0;
  }
}

/// What was computed in place, or given up, is computed again from what it came from, in the same order: to the same
/// bits.
template <int BlockSize>
void IncrementalCholesky<BlockSize>::rollback() {
  clear_changes();
  recomputed_.clear();
  restored_.clear();
  for (Offset k = journal_.entries().size() - 1; k >= 0; --k) undo(journal_.entries()[k]);
  journal_.clear();
  for (Offset k = recomputed_.size() - 1; k >= 0; --k) {
    if (tree_.has_numbers(recomputed_[k])) static_cast<void>(compute(recomputed_[k]));
  }
  compute_restored();
  totals_ = totals_before_;
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
      std::ranges::copy(numbers, terms_.jacobian(entry.id));
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
      std::ranges::copy(numbers, solution_.data() + Offset{entry.id} * BlockSize);
      break;
  }
}

}  // namespace chainslam
