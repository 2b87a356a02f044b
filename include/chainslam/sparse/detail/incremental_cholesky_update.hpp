#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "chainslam/core/table.hpp"
#include "chainslam/sparse/incremental_cholesky.hpp"

// How `IncrementalCholesky` brings its factor up to date: what has to be computed, and in which order.

namespace chainslam {

template <int BlockSize>
template <Executor Exec>
FactorizationResult IncrementalCholesky<BlockSize>::factorize(const Exec& executor) {
  for (const Index term : written_) {
    if (damped() || !terms_.linked(term) || terms_.counted(term)) continue;
    totals_.squared_residuals += terms_.squared_residual(term);
    terms_.set_counted(term, true);
  }
  written_.clear();
  promote_heavy();
  reorder_near();
  collect_affected();
  list_refreshed();
  FactorizationResult result = compute_all(ready_.range(0, ready_.size()), executor);
  if (result.ok() && affected_.size() > 0) {
    order_affected();
    result = compute_all(fresh_.range(0, fresh_.size()), executor);
  }
  for (const Index variable : affected_) local_[variable] = -1;
  ++totals_.factorizations;
  tree_.compact();
  return result;
}

template <int BlockSize>
void IncrementalCholesky<BlockSize>::promote_heavy() {
  double work = 0.0, whole = 0.0, columns = 1.0;
  for (const Index node : stale_) {
    if (tree_[node].parent == -1) whole += tree_[node].work;
    if (tree_[node].stale != Stale::numbers) continue;
    work += Front::work(tree_[node].columns, tree_[node].rows);
    columns += tree_[node].columns;
  }
  if (work < options_.reorder_work * columns || work < options_.reorder_share * whole) return;
  for (Offset k = 0; k < stale_.size(); ++k) {
    if (tree_[stale_[k]].stale == Stale::numbers) mark(stale_[k], Stale::order);
  }
}

/// What lies beyond the near variables grows as a planar graph's separators.
template <int BlockSize>
Index IncrementalCholesky<BlockSize>::near_count() const {
  return static_cast<Index>(options_.near_variables * std::sqrt(std::max(1.0, size() / 50000.0)));
}

/// Where it would cost more than it saves, none: neither where little is due, nor where much more would be.
template <int BlockSize>
void IncrementalCholesky<BlockSize>::reorder_near() {
  constexpr double most_more = 3.0;  // times the work at hand: separators that are not reached stay as they are
  near_.clear();
  far_ = false;
  Index columns = 0;
  double work = 0.0;
  for (const Index node : stale_) {
    if (tree_[node].stale != Stale::order) continue;
    columns += tree_[node].columns;
    work += Front::work(tree_[node].columns, tree_[node].rows);
  }
  if (columns <= near_count() / 4 && work < options_.near_work) return;
  near_.list(terms_, size(), size() - 1, near_count());
  const Index count = std::min(near_count() / 2, near_count() - options_.near_variables);
  detail::Table<Index> above;
  double more = 0.0;
  if (to_index(place_of_.size()) < tree_.size()) place_of_.resize(tree_.size(), -1);
  for (const Index variable : near_.nearest(count)) {
    Index node = tree_.node_of(variable);
    for (; node != -1 && tree_[node].stale != Stale::order && place_of_[node] == -1; node = tree_[node].parent) {
      place_of_[node] = 0;  // seen
      above.push_back(node);
      more += Front::work(tree_[node].columns, tree_[node].rows);
    }
  }
  for (const Index node : above) place_of_[node] = -1;
  const bool worthwhile = more <= most_more * std::max(work, options_.near_work);
  far_ = work + (worthwhile ? more : 0.0) > options_.far_work;
  if (far_) surroundings_.follow(terms_, near_, size(), options_.surroundings * near_count());
  if (!worthwhile) return;
  for (const Index node : above) mark(node, Stale::order);
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
  sort_affected();
  for (Index k = 0; k < to_index(affected_.size()); ++k) local_[affected_[k]] = k;
}

template <int BlockSize>
void IncrementalCholesky<BlockSize>::sort_affected() {
  std::sort(affected_.begin(), affected_.end());
  const Index newest = size() - options_.late_variables;
  late_.clear();
  if (near_.empty() && to_index(affected_.size()) > near_count() / 4)
    near_.list(terms_, size(), size() - 1, near_count());
  if (near_.empty()) {
    late_.push_back(
        static_cast<Index>(std::lower_bound(affected_.begin(), affected_.end(), newest) - affected_.begin()));
    return;
  }
  std::array<detail::Table<Index>, 2> later;  // surroundings, near variables
  Index others = 0;
  for (const Index variable : affected_) {
    if (variable >= newest || near_.contains(variable))
      later[1].push_back(variable);
    else if (far_ && surroundings_.contains(variable))
      later[0].push_back(variable);
    else
      affected_[others++] = variable;
  }
  affected_.resize(others);
  for (const detail::Table<Index>& variables : later) {
    late_.push_back(to_index(affected_.size()));
    affected_.append(variables.all());
  }
}

template <int BlockSize>
void IncrementalCholesky<BlockSize>::list_refreshed() {
  for (const Index node : stale_) {
    const Index parent = tree_[node].parent;
    if (tree_[node].stale == Stale::numbers && (parent == -1 || tree_[parent].stale == Stale::order))
      stack_.push_back(node);
  }
  list_below(ready_, [&](Index child) { return tree_[child].stale == Stale::numbers || !tree_.has_update(child); });
  for (const Index node : ready_) {
    if (tree_[node].stale == Stale::numbers) journal_.add(detail::Change::node_numbers, node);
  }
}

template <int BlockSize>
void IncrementalCholesky<BlockSize>::order_affected() {
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
  const bool surrounded = late_.size() > 1 && late_[0] < late_[1];
  plan_.plan(late_.range(surrounded ? 1 : 0, late_.size()), BlockSize);
  if (surrounded) {
    // Surroundings apart only if that costs nothing now: where it does, it also would later.
    detail::PartialElimination apart = plan_;
    apart.plan(late_.all(), BlockSize);
    if (apart.template work<BlockSize>() <= plan_.template work<BlockSize>()) std::swap(plan_, apart);
  }
  work_.reordered += to_index(affected_.size());
  create_nodes();
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
  for (const Index node : fresh_) {
    if (tree_[node].parent == -1) stack_.push_back(node);
  }
  list_below(fresh_, [&](Index child) { return !tree_.has_update(child); });  // the others are neither new nor missed
}

}  // namespace chainslam
