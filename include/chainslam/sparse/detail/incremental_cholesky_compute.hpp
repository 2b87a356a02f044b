#pragma once

#include <algorithm>
#include <type_traits>
#include <utility>

#include "chainslam/core/table.hpp"
#include "chainslam/sparse/detail/tree_parts.hpp"
#include "chainslam/sparse/incremental_cholesky.hpp"

// How `IncrementalCholesky` computes fronts, some at the same time.

namespace chainslam {

/// Each node right after those below it, so that what they leave to it waits no longer than it must.
template <int BlockSize>
template <class Descends>
void IncrementalCholesky<BlockSize>::list_below(detail::Table<Index>& nodes, Descends&& descends) {
  nodes.clear();
  while (stack_.size() > 0) {
    const Index node = stack_.back();
    stack_.pop_back();
    nodes.push_back(node);
    for (Index child = tree_[node].first_child; child != -1; child = tree_[child].next) {
      if (descends(child)) stack_.push_back(child);
    }
  }
  std::reverse(nodes.begin(), nodes.end());
}

template <int BlockSize>
void IncrementalCholesky<BlockSize>::keep_updates(bool keep) {
  keeps_updates_ = keep;
  if (!keep) tree_.release_updates();
}

template <int BlockSize>
void IncrementalCholesky<BlockSize>::forget_updates(Index node, std::mutex* memory) {
  tree_[node].work = Front::work(tree_[node].columns, tree_[node].rows);
  for (Index child = tree_[node].first_child; child != -1; child = tree_[child].next)
    tree_[node].work += tree_[child].work;
  const bool kept = tree_[node].work * static_cast<double>(totals_.factorizations) >
                    options_.forgotten_share * totals_.multiplications;
  if (kept && keeps_updates_) return;
  const auto lock = memory == nullptr ? std::unique_lock<std::mutex>() : std::unique_lock(*memory);
  for (Index child = tree_[node].first_child; child != -1; child = tree_[child].next) {
    if (tree_.has_update(child)) tree_.release_update(child);
  }
}

template <int BlockSize>
void IncrementalCholesky<BlockSize>::damp(Index node, const Front& front) {
  Index column = 0;
  for (const Index variable : tree_.columns(node)) {
    const auto block = front.block(column, column);
    double* const scale = front.scale(column++);
    double* const diagonal = diagonal_.data() + Offset{variable} * BlockSize;
    for (int k = 0; k < BlockSize; ++k) {
      diagonal[k] = scale[k];
      block.data[k * (block.stride + 1)] += damping_ * diagonal[k];
      scale[k] += damping_ * diagonal[k];
    }
  }
}

template <int BlockSize>
template <Executor Exec>
FactorizationResult IncrementalCholesky<BlockSize>::compute(Index node, Assembly& assembly, std::mutex* memory,
                                                            const Exec& executor) {
  if (!tree_.has_update(node)) {
    const auto lock = memory == nullptr ? std::unique_lock<std::mutex>() : std::unique_lock(*memory);
    tree_.take_numbers(node);
  }
  assembly.assemble(tree_, terms_, fixed_, node);
  const Front front = tree_.front(node);
  if (damped()) damp(node, front);
  const Index bad = front.eliminate(options_.pivot_tolerance, executor);
  if (bad != -1)
    return {FactorizationStatus::not_positive_definite, tree_.columns(node)[static_cast<std::size_t>(bad)]};
  front.substitute_forward();
  const double* const right = front.own_right();
  double lowered = 0.0;
  for (Offset k = 0; k < Offset{front.columns()} * BlockSize; ++k) lowered += right[k] * right[k];
  tree_[node].lowered = lowered;
  return {};
}

/// Sums are taken in the order of `nodes`, before and after, so that threads do not change their bits.
template <int BlockSize>
template <Executor Exec>
FactorizationResult IncrementalCholesky<BlockSize>::compute_all(std::span<const Index> nodes, const Exec& executor) {
  double work = 0.0;
  for (const Index node : nodes) {
    const double of_node = Front::work(tree_[node].columns, tree_[node].rows);
    work += of_node;
    // What is only computed again for its update does not make more be forgotten: that would feed on itself.
    if (tree_[node].stale != Stale::none) totals_.multiplications += of_node;
    work_.refactorized += tree_[node].columns;
    totals_.lowered -= tree_[node].lowered;
  }
  work_.multiplications += work;
  // The rounding of what was large before would outweigh what is small now.
  if (to_index(nodes.size()) == totals_.nodes) totals_.lowered = 0.0;
  FactorizationResult result;
  bool shared = false;
  if constexpr (!std::is_same_v<Exec, Serial>) {
    shared = work >= options_.least_shared_work;
    if (shared) result = compute_parts(nodes, executor);
  }
  for (std::size_t k = 0; !shared && k < nodes.size() && result.ok(); ++k) {
    result = compute(nodes[k]);
    forget_updates(nodes[k]);
  }
  for (const Index node : nodes) totals_.lowered += tree_[node].lowered;
  return result;
}

template <int BlockSize>
std::vector<std::vector<Index>> IncrementalCholesky<BlockSize>::parts_of(std::span<const Index> nodes) {
  const Index size = to_index(nodes.size());
  if (to_index(place_of_.size()) < tree_.size()) place_of_.resize(tree_.size(), -1);
  for (Index k = 0; k < size; ++k) place_of_[nodes[static_cast<std::size_t>(k)]] = k;
  const auto at = [&](Index k) -> const auto& { return tree_[nodes[static_cast<std::size_t>(k)]]; };
  const auto parts = detail::list_parts(detail::divide_tree(
      size, [&](Index k) { return at(k).parent == -1 ? -1 : place_of_[at(k).parent]; },
      [&](Index k) { return Front::work(at(k).columns, at(k).rows); }));
  for (const Index node : nodes) place_of_[node] = -1;
  return parts;
}

/// Of several nodes that fail, the first in the order of `nodes` counts; what is above the parts is good up to there.
template <int BlockSize>
template <Executor Exec>
FactorizationResult IncrementalCholesky<BlockSize>::compute_parts(std::span<const Index> nodes, const Exec& executor) {
  const std::vector<std::vector<Index>> parts = parts_of(nodes);
  PartResult first{to_index(nodes.size()), {}};
  std::vector<PartResult> results(parts.size() - 1, first);
  std::mutex memory;
  executor.for_chunks(to_index(results.size()), 1, [&](Index begin, Index) {
    const auto k = static_cast<std::size_t>(begin);
    results[k] = compute_part(nodes, parts[k], first.stop, memory, Serial{});
  });
  for (const PartResult& result : results) {
    if (result.stop < first.stop) first = result;
  }
  const PartResult above = compute_part(nodes, parts.back(), first.stop, memory, executor);
  return above.stop < first.stop ? above.result : first.result;
}

/// Factorizes one part of the tree.
template <int BlockSize>
template <Executor Exec>
auto IncrementalCholesky<BlockSize>::compute_part(std::span<const Index> nodes, std::span<const Index> places,
                                                  Index stop, std::mutex& memory, const Exec& executor) -> PartResult {
  Assembly assembly;
  {
    const std::scoped_lock lock(memory);
    if (!assemblies_.empty()) {
      assembly = std::move(assemblies_.back());
      assemblies_.pop_back();
    }
  }
  assembly.add_variables(size());
  for (const Index place : places) {
    if (place >= stop) break;
    const Index node = nodes[static_cast<std::size_t>(place)];
    const FactorizationResult result = compute(node, assembly, &memory, executor);
    if (!result.ok()) return {place, result};
    forget_updates(node, &memory);
  }
  const std::scoped_lock lock(memory);
  assemblies_.push_back(std::move(assembly));
  return {stop, {}};
}

}  // namespace chainslam
