#pragma once

#include <algorithm>
#include <cmath>

#include "chainslam/core/table.hpp"
#include "chainslam/sparse/incremental_cholesky.hpp"

// How `IncrementalCholesky` brings its solution up to date, and where it keeps the old one.

namespace chainslam {

template <int BlockSize>
void IncrementalCholesky<BlockSize>::solve(bool exact) {
  changed_.clear();
  moves_.clear();
  const double error = std::max(squared_error(), options_.least_error);
  const double whole = exact ? 0.0 : options_.relative_excess * error;
  const double mean = whole / std::max(1, size());
  tolerance_.left = std::max(0.0, whole - totals_.excess);
  tolerance_.of_block = std::min(options_.block_share * tolerance_.left, options_.largest_excess * mean);
  for (const Index node : fresh_) {
    if (tree_[node].parent == -1) stack_.push_back(node);
  }
  for (const Index node : stale_) {
    if (tree_[node].parent == -1 && tree_[node].stale != Stale::order) stack_.push_back(node);
  }
  substitute_below([](Index) { return true; }, [&](Index child) { return is_outdated(child); });
  // Once all is taken, the next solution is exact. In a large system, fronts that took more than a variable's mean for
  // each block are solved again before that.
  if (options_.largest_excess < options_.block_share * size() && totals_.excess > 0.9 * whole) {
    lower_excess({whole, mean});
    if (totals_.excess > 0.5 * whole) lower_excess({});
  }
  for (const Index variable : changed_) local_[variable] = -1;
  clear_changes();
}

template <int BlockSize>
void IncrementalCholesky<BlockSize>::lower_excess(const detail::ExcessTolerance& tolerance) {
  tolerance_ = tolerance;
  const auto exceeds = [&](Index node) {
    return tree_[node].excess > tolerance_.of_front(tree_[node].columns, tree_[node].rows);
  };
  place_of_.resize(std::max(place_of_.size(), Offset{tree_.size()}), -1);
  detail::Table<Index> ways;  // to those that do
  for (Index node = 0; node < tree_.size(); ++node) {
    if (!tree_.has_numbers(node) || !exceeds(node)) continue;
    for (Index above = node; above != -1 && place_of_[above] == -1; above = tree_[above].parent) {
      place_of_[above] = 0;
      ways.push_back(above);
      if (tree_[above].parent == -1) stack_.push_back(above);
    }
  }
  substitute_below([&](Index node) { return exceeds(node) || is_outdated(node); },
                   [&](Index child) { return place_of_[child] != -1 || is_outdated(child); });
  for (const Index node : ways) place_of_[node] = -1;
}

/// Parents before children, from the nodes on the stack.
template <int BlockSize>
template <class Solves, class Descends>
void IncrementalCholesky<BlockSize>::substitute_below(Solves&& solves, Descends&& descends) {
  while (stack_.size() > 0) {
    const Index node = stack_.back();
    stack_.pop_back();
    if (solves(node)) substitute(node);
    for (Index child = tree_[node].first_child; child != -1; child = tree_[child].next) {
      if (!descends(child)) continue;
      __builtin_prefetch(tree_[child].data);
      __builtin_prefetch(tree_[child].variables);
      stack_.push_back(child);
    }
  }
}

template <int BlockSize>
void IncrementalCholesky<BlockSize>::clear_changes() {
  for (const Index node : stale_) tree_[node].stale = Stale::none;
  for (const Index node : fresh_) tree_[node].stale = Stale::none;
  stale_.clear();
  fresh_.clear();
  reordered_.clear();
  written_.clear();
}

template <int BlockSize>
void IncrementalCholesky<BlockSize>::substitute(Index node) {
  if (keeps(node)) return;
  const Front front = tree_.front(node);
  front.prefetch();
  const std::span<const Index> variables = tree_.variables(node);
  const auto columns = static_cast<std::size_t>(front.columns());
  const Offset own = Offset{front.columns()} * BlockSize;
  work_.substituted += front.columns();
  gathered_.resize(front.stride() + own);
  double* const x = gathered_.data();
  double* const old = x + front.stride();
  std::copy_n(front.own_right(), own, x);
  for (std::size_t k = columns; k < variables.size(); ++k)
    std::copy_n(solution(variables[k]).data(), BlockSize, x + static_cast<Offset>(k) * BlockSize);
  if (damped()) {
    front.substitute_backward(x);
  } else {
    for (std::size_t k = 0; k < columns; ++k)
      std::copy_n(solution(variables[k]).data(), BlockSize, old + static_cast<Offset>(k) * BlockSize);
    front.subtract_rows(x);
    const double excess = front.excess(x, old);
    const bool kept = excess <= tolerance_.of_front(front.columns(), front.rows());
    set_excess(node, kept ? excess : 0.0);
    if (kept) return;
    journal_.append_numbers({old, static_cast<std::size_t>(own)});
    front.solve_columns(x);
  }
  for (std::size_t k = 0; k < columns; ++k) {
    const Index variable = variables[k];
    const double* const from = x + static_cast<Offset>(k) * BlockSize;
    double* const to = solution_.data() + Offset{variable} * BlockSize;
    Index& place = local_[variable];
    if (place == -1) {
      place = to_index(changed_.size());
      changed_.push_back(variable);
      moves_.resize(moves_.size() + BlockSize, 0.0);
    }
    for (int c = 0; c < BlockSize; ++c) moves_[Offset{place} * BlockSize + c] += std::abs(from[c] - to[c]);
    std::copy_n(from, BlockSize, to);
  }
}

template <int BlockSize>
void IncrementalCholesky<BlockSize>::set_excess(Index node, double excess) {
  double& of_node = tree_[node].excess;
  journal_.add_numbers(detail::Change::node_solution, node, {&of_node, 1});
  totals_.excess += excess - of_node;
  of_node = excess;
}

template <int BlockSize>
bool IncrementalCholesky<BlockSize>::is_outdated(Index node) const {
  if (tree_[node].stale != Stale::none) return true;
  for (const Index variable : tree_.rows(node))
    if (local_[variable] != -1) return true;
  return false;
}

/// The excess is the squared length of a vector, which the rows' moves change by no more than their sizes times the
/// norms of their rows: most large fronts need not be read. What is added to the excess is that bound.
template <int BlockSize>
bool IncrementalCholesky<BlockSize>::keeps(Index node) {
  const auto& at = tree_[node];
  if (at.stale != Stale::none || damped() || !Front::is_large(at.columns, at.rows)) return false;
  const double most = tolerance_.of_front(at.columns, at.rows);
  if (at.excess >= most) return false;
  const double* norms = tree_.front(node).row_norms();
  double length = std::sqrt(at.excess);
  for (const Index variable : tree_.rows(node)) {
    const Index place = local_[variable];
    for (int c = 0; c < BlockSize && place != -1; ++c) length += norms[c] * moves_[Offset{place} * BlockSize + c];
    norms += BlockSize;
  }
  const double excess = length * length;
  if (!(excess <= most)) return false;
  set_excess(node, excess);
  return true;
}

}  // namespace chainslam
