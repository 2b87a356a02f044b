#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>

#include <algorithm>
#include "chainslam/factor_graph/detail/dense_elimination.hpp"
#include "chainslam/factor_graph/incremental_smoother.hpp"

// How `IncrementalSmoother` takes in values and factors, and lets them go.

namespace chainslam {

template <class Group, class... Extra>
template <class Graph>
Key IncrementalSmoother<Group, Extra...>::append(const Graph& graph) {
  const Key first = size();
  for (const Group& value : graph.values()) add_value(value);
  graph.for_each_factor([&](auto factor) {
    detail::shift_keys(factor, first);
    add(factor);
  });
  for (Key key = first; key < size(); ++key)
    if (graph.is_fixed(key - first)) set_fixed(key);
  return first;
}

template <class Group, class... Extra>
Key IncrementalSmoother<Group, Extra...>::add_value(const Group& initial) {
  begin();
  solver_.add_variable();
  look_.push_back(options_.first_look);
  waiting_.add_variable();
  marginalized_.push_back(0);
  if (!components_outdated_) components_.add_variable();
  const Key key = origins_.add(initial);
  estimates_.add(initial);
  estimate(key);
  changes_.push_back({ChangeKind::value_added, key, 0.0});
  return key;
}

template <class Group, class... Extra>
template <Factor F>
FactorId IncrementalSmoother<Group, Extra...>::add(const F& factor) {
  static_assert(Pools::template has<F>, "IncrementalSmoother: name this type of factor in the smoother's Extra");
  const Index term = begin_term(factor.keys(), detail::rows_of(factor));
  const FactorId id = pools_.add(factor, term);
  note_added(term);
  return id;
}

template <class Group, class... Extra>
template <Factor F>
FactorId IncrementalSmoother<Group, Extra...>::add(const F& factor, double weight) {
  const FactorId id = add(factor);
  const std::uint64_t losses = losses_;
  set_weight(id, weight);
  losses_ = losses;  // what was not there yet is not lost
  return id;
}

template <class Group, class... Extra>
FactorId IncrementalSmoother<Group, Extra...>::add_prior(Key key, const Group& mean, const Noise& noise) {
  return add(PriorFactor<Group>{key, mean, noise.sqrt_information()});
}

template <class Group, class... Extra>
FactorId IncrementalSmoother<Group, Extra...>::add_between(Key from, Key to, const Group& measurement,
                                                           const Noise& noise) {
  return add(BetweenFactor<Group>{from, to, measurement, noise.sqrt_information()});
}

template <class Group, class... Extra>
Index IncrementalSmoother<Group, Extra...>::begin_term(std::span<const Key> keys, Index rows) {
  require_keys(keys);
  begin();
  return solver_.add_term(keys, rows);
}

template <class Group, class... Extra>
void IncrementalSmoother<Group, Extra...>::note_added(Index term) {
  if (term >= to_index(touched_.size())) touched_.resize(Offset{term} + 1, 0);
  if (term >= to_index(off_.size())) off_.resize(Offset{term} + 1, 0.0);
  touched_[term] = 1;  // it will be linearized in any case
  recount(term);
  changes_.push_back({ChangeKind::factor_added, term, 0.0});
  if (!components_outdated_) tie(term);
}

template <class Group, class... Extra>
void IncrementalSmoother<Group, Extra...>::require_keys(std::span<const Key> keys) const {
  for (std::size_t i = 0; i < keys.size(); ++i) {
    require_known(keys[i]);
    if (is_marginalized(keys[i])) refuse("variable ", keys[i], " was marginalized");
    for (std::size_t j = 0; j < i; ++j) {
      if (keys[i] == keys[j]) refuse("a factor names variable ", keys[i], " twice");
    }
  }
}

template <class Group, class... Extra>
void IncrementalSmoother<Group, Extra...>::remove(const FactorId& id) {
  const Index term = term_of(id);
  begin();
  components_outdated_ = components_outdated_ || matters_to_components(term);
  remove_term(term);
}

/// Whether something may float without a factor. A prior ties nothing together, and most are not what holds a part.
template <class Group, class... Extra>
bool IncrementalSmoother<Group, Extra...>::matters_to_components(Index term) {
  const auto slots = solver_.terms().slots(term);
  if (slots.size() != 1) return true;
  const Index holder = components_.holder(slots.front().variable);
  return holder < 0 || holder == term;
}

template <class Group, class... Extra>
void IncrementalSmoother<Group, Extra...>::remove_term(Index term) {
  ++losses_;
  set_off(term, 0.0);
  costs_.remove(term);
  solver_.remove_term(term);
  set_alive(term, false);
  changes_.push_back({ChangeKind::factor_removed, term, 0.0});
}

/// Its cost has changed.
template <class Group, class... Extra>
void IncrementalSmoother<Group, Extra...>::recount(Index term) {
  for (const auto& slot : solver_.terms().slots(term)) costs_.change(slot.variable);
}

template <class Group, class... Extra>
void IncrementalSmoother<Group, Extra...>::set_fixed(Key key, bool fixed) {
  require_keys(std::array<Key, 1>{key});  // a marginalized one stays as it is
  if (solver_.is_fixed(key) == fixed) return;
  begin();
  ++losses_;
  relinearize_at_estimate(key);
  solver_.set_fixed(key, fixed);
  components_outdated_ = true;
}

template <class Group, class... Extra>
void IncrementalSmoother<Group, Extra...>::set_weight(const FactorId& id, double weight) {
  const Index term = term_of(id);
  if (!traits(term).weighable) refuse("a factor's weight is that of its kernel");
  if (!(weight >= 0.0) || !std::isfinite(weight)) refuse("a weight is finite and not negative");
  const double before = this->weight(id);
  if (weight == before) return;
  begin();
  if (weight < before) ++losses_;
  changes_.push_back({ChangeKind::factor_weighed, term, before});
  weigh_term(term, weight);
  recount(term);
  touch(term);
}

template <class Group, class... Extra>
double IncrementalSmoother<Group, Extra...>::weight(const FactorId& id) const {
  static_cast<void>(term_of(id));  // it is there
  return pools_.pool(id.type).place(id.slot).weight;
}

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
