#pragma once

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
      return std::ranges::find(prior.variables, key) != prior.variables.end();
    };
    for (const auto& prior : left) {
      if (concerns(prior)) stays.insert(stays.end(), prior.variables.begin(), prior.variables.end());
    }
    std::ranges::sort(stays);
    stays.erase(std::unique(stays.begin(), stays.end()), stays.end());
    std::erase(stays, key);
    std::vector<Group> points;
    for (const Key other : stays) points.push_back(estimates_[other]);

    const bool known = !terms.empty() || std::ranges::any_of(left, concerns);
    detail::DenseElimination<Group> elimination(key, std::move(stays));
    for (const Index term : terms) {
      pools_.visit_term(term, [&](const auto& entry) {
        detail::visit_weighed(entry, [&](const auto& factor) {
          elimination.add(factor.keys(), detail::weighted_linearization(factor, estimates_));
        });
      });
      remove_term(term);
    }
    for (const auto& prior : left) {
      if (concerns(prior)) elimination.add(prior.keys(), prior.linearize(estimates_));
    }
    std::erase_if(left, concerns);
    if (known) left.push_back(elimination.eliminate(!solver_.is_fixed(key), std::move(points)));
    relinearize_at_estimate(key);
    solver_.set_fixed(key, true);
    marginalized_[static_cast<std::size_t>(key)] = 1;
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
  if (options_.lag <= 0) return;
  std::vector<Key> old;
  for (; oldest_ < size() - options_.lag; ++oldest_) {
    if (!solver_.is_eliminated(oldest_) && !solver_.is_fixed(oldest_)) break;
    if (!is_marginalized(oldest_)) old.push_back(oldest_);
  }
  if (!old.empty()) marginalize(old);
}

}  // namespace chainslam
