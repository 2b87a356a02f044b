#pragma once

#include <algorithm>

#include "chainslam/factor_graph/detail/dense_elimination.hpp"
#include "chainslam/factor_graph/detail/incremental_smoother_class.hpp"

// How `IncrementalSmoother` gives up variables and keeps what they tell.

namespace chainslam {

/// One after another, so that each is eliminated among its own neighbours: what one leaves for a later one is merged
/// into what that leaves.
template <class Group, class... Extra>
void IncrementalSmoother<Group, Extra...>::marginalize(std::span<const Key> keys) {
  for (const Key key : keys) require_known(key);
  begin();
  std::vector<LinearPrior<Group>> left;
  for (const Key key : keys) {
    if (is_marginalized(key)) continue;
    std::vector<Index> terms;
    std::vector<Key> stays;
    for (Index k = solver_.terms().first(key); k != -1; k = solver_.terms().slot(k).next) {
      terms.push_back(solver_.terms().slot(k).term);
      for (const auto& slot : solver_.terms().slots(terms.back())) stays.push_back(slot.variable);
    }
    const auto concerns = [&](const LinearPrior<Group>& prior) {
      return std::find(prior.variables.begin(), prior.variables.end(), key) != prior.variables.end();
    };
    for (const auto& prior : left) {
      if (concerns(prior)) stays.insert(stays.end(), prior.variables.begin(), prior.variables.end());
    }
    detail::sort_unique(stays);
    std::erase(stays, key);
    std::vector<Group> points;
    for (const Key other : stays) points.push_back(estimates_[other]);

    bool known = !terms.empty();
    detail::DenseElimination elimination(dof, key, stays);
    for (const Index term : terms) {
      list_keys(term, keys_);
      numbers_.resize(solver_.terms().size(term));
      pools_.linearize(term, estimates_, numbers_.data(), solver_.terms().size(term));
      elimination.add(keys_, solver_.terms().rows(term), numbers_.data());
      remove_term(term);
    }
    for (const auto& prior : left) {
      if (!concerns(prior)) continue;
      known = true;
      numbers_.clear();
      numbers_.append(detail::linearization(prior, estimates_, detail::Kernels::applied));
      elimination.add(prior.variables, detail::rows_of(prior), numbers_.data());
    }
    std::erase_if(left, concerns);
    if (known) {
      detail::DenseElimination::Left of_others = elimination.eliminate(!solver_.is_fixed(key));
      left.push_back(
          {std::move(stays), std::move(points), std::move(of_others.sqrt_information), std::move(of_others.offset)});
    }
    relinearize_at_estimate(key);
    solver_.set_fixed(key, true);
    marginalized_[key] = 1;
    changes_.push_back({ChangeKind::marginalized, key, 0.0});
  }
  // What held and tied the parts of the graph still does.
  for (const LinearPrior<Group>& prior : left) {
    if (!prior.variables.empty()) add(prior);
  }
}

/// The oldest of those that the last update knew.
template <class Group, class... Extra>
void IncrementalSmoother<Group, Extra...>::marginalize_old() {
  std::vector<Key> old;
  for (; oldest_ < size() - options_.lag; ++oldest_) {
    if (!solver_.is_eliminated(oldest_) && !solver_.is_fixed(oldest_)) break;
    if (!is_marginalized(oldest_)) old.push_back(oldest_);
  }
  if (!old.empty()) marginalize(old);
}

}  // namespace chainslam
