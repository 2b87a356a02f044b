#pragma once

#include <algorithm>

#include "chainslam/core/compiled.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/factor_graph/detail/open_directions.hpp"
#include "chainslam/factor_graph/detail/springed_terms.hpp"
#include "chainslam/factor_graph/incremental_smoother.hpp"

// How `IncrementalSmoother` updates.

namespace chainslam {

template <class Group, class... Extra>
template <Executor Exec>
UpdateReport IncrementalSmoother<Group, Extra...>::update(const Exec& executor) {
  return update_to(false, executor);
}

template <class Group, class... Extra>
template <Executor Exec>
UpdateReport IncrementalSmoother<Group, Extra...>::update_to(bool exact, const Exec& executor) {
  begin();
  if (options_.lag > 0) (this->*marginalize_old_)();
  UpdateReport report;
  solver_.reset_work();
  report.variables = find_floating();
  if (!report.variables.empty()) {
    report.status = UpdateStatus::unconstrained;
    report.free = components_.free_parts(report.variables, origins_);
  } else {
    relinearize_waiting(exact);
    if (!linearize_touched(report) || !linearize_added(report)) {
      report.status = UpdateStatus::not_finite;
    } else if (const FactorizationResult result = solver_.factorize(executor); !result.ok()) {
      report.status = UpdateStatus::singular;
      report.variables.push_back(result.block_column);
      report.free = open_parts();
    }
  }
  if (!report.ok()) {
    revert();
    open_ = false;
    return report;
  }
  solver_.solve(exact);
  for (const Key key : solver_.changed()) estimate(key);
  report.squared_error = solver_.squared_error() + solver_.excess();
  report.gap = solver_.excess();
  look_at_changed(report);
  report.waiting = impatient() ? waiting_.count() : to_index(far_.size());
  report.work = solver_.work();
  open_ = false;
  ++revision_;
  return report;
}

template <class Group, class... Extra>
void IncrementalSmoother<Group, Extra...>::begin() {
  if (open_) return;
  open_ = true;
  solver_.begin();
  for (const Change& change : changes_) {
    if (change.kind == ChangeKind::factor_removed) release(change.id);
  }
  changes_.clear();
  origins_before_.clear();
  multipliers_before_.clear();
  waiting_.begin();
  far_before_ = far_;
  waiting_gap_before_ = waiting_gap_;
}

template <class Group, class... Extra>
void IncrementalSmoother<Group, Extra...>::revert() {
  for (const Index term : touched_terms_) touched_[term] = 0;
  touched_terms_.clear();
  waiting_.undo();
  for (Offset k = changes_.size(); k-- > 0;) undo_change(changes_[k]);
  changes_.clear();
  far_ = far_before_;
  waiting_gap_ = waiting_gap_before_;
  solver_.rollback();
  costs_.outdate();
  ++losses_;
  estimate_all();
  components_outdated_ = true;
  oldest_ = 0;
}

template <class Group, class... Extra>
void IncrementalSmoother<Group, Extra...>::undo() {
  revert();
  open_ = false;
  revision_ += 2;
}

template <class Group, class... Extra>
void IncrementalSmoother<Group, Extra...>::undo_change(const Change& change) {
  switch (change.kind) {
    case ChangeKind::value_added:
      origins_.drop_last();
      estimates_.drop_last();
      look_.pop_back();
      waiting_.drop_last_variable();
      marginalized_.pop_back();
      break;
    case ChangeKind::factor_added:
      touched_[change.id] = 0;
      set_alive(change.id, false);
      release(change.id);
      break;
    case ChangeKind::factor_removed:
      set_alive(change.id, true);
      break;
    case ChangeKind::factor_weighed:
      weigh_term(change.id, change.look);
      break;
    case ChangeKind::factor_tightened:
      if constexpr (any_constraint) restore_multipliers(change);
      break;
    case ChangeKind::marginalized:
      marginalized_[change.id] = 0;
      break;
    case ChangeKind::origin_moved:
      origins_[change.id] = origins_before_.back();
      origins_before_.pop_back();
      look_[change.id] = change.look;
      break;
    case ChangeKind::judged:
      off_[change.id] = change.look;
      break;
    case ChangeKind::looked:
      look_[change.id] = change.look;
      break;
  }
}

/// Only parts that have changed need looking at; after a removal, all may have.
template <class Group, class... Extra>
std::vector<Key> IncrementalSmoother<Group, Extra...>::find_floating() {
  if (components_outdated_) return find_all_floating();
  std::vector<Key> floating;
  for (const Change& change : changes_) {
    if (change.kind != ChangeKind::value_added || components_.is_held(change.id)) continue;
    const Key root = components_.find(change.id);
    floating.push_back(root);
  }
  detail::sort_unique(floating);
  return floating;
}

/// What the factors leave open, at the estimates.
template <class Group, class... Extra>
std::vector<FreePart> IncrementalSmoother<Group, Extra...>::open_parts() const {
  detail::SpringedTerms<dof> system;
  for (Key key = 0; key < size(); ++key) system.add_variable(is_fixed(key));
  std::vector<Key> keys;
  for (const Index term : pools_.terms()) {
    list_keys(term, keys);
    double* const numbers = system.add(keys, solver_.terms().rows(term));
    pools_.linearize(term, estimates_, numbers, solver_.terms().size(term));
  }
  return detail::open_parts(system, estimates_);
}

/// Relinearizes what waits: the oldest first, where all that waits has become worth it or a step was too long;
/// else what costs no more than its linearization, since its fronts are due.
template <class Group, class... Extra>
void IncrementalSmoother<Group, Extra...>::relinearize_waiting(bool exact) {
  // Each such update recomputes the largest separators, however few variables it takes.
  const double most = options_.largest_relinearization * std::max(1.0, size() / 50000.0);
  Index budget = exact ? size() : static_cast<Index>(std::clamp(most, 0.0, static_cast<double>(size())));
  detail::Table<Key> due;
  if (exact || impatient()) due = waiting_.keys();
  due.append(far_.all());
  const auto relinearize = [&](Key key) {
    if (budget == 0 || key == -1 || !waiting_.waits(key)) return;
    --budget;
    relinearize_at_estimate(key);
  };
  for (const Key key : due) relinearize(key);
  far_.keep_if([&](Key key) { return waiting_.waits(key); });
  solver_.for_each_due([&](Key key) {
    if (waiting_.waits(key) && all_due(key)) relinearize(key);
  });
}

template <class Group, class... Extra>
bool IncrementalSmoother<Group, Extra...>::impatient() const {
  const double error = std::max(solver_.squared_error(), options_.least_error);
  const double tolerated = options_.patience * options_.nonlinear_tolerance * error;
  return tolerated == 0.0 || !(waiting_gap_ < tolerated);
}

/// Whether relinearizing a variable's factors reaches no front that is not due.
template <class Group, class... Extra>
bool IncrementalSmoother<Group, Extra...>::all_due(Key key) const {
  for (Index k = solver_.terms().first(key); k != -1; k = solver_.terms().slot(k).next) {
    for (const auto& slot : solver_.terms().slots(solver_.terms().slot(k).term)) {
      if (!solver_.is_due(slot.variable)) return false;
    }
  }
  return true;
}

/// What a linear prediction is worth once its variables wait because of it.
template <class Group, class... Extra>
void IncrementalSmoother<Group, Extra...>::set_off(Index term, double off) {
  double& before = off_[term];
  if (off == before) return;
  changes_.push_back({ChangeKind::judged, term, before});
  waiting_gap_ += off - before;
  before = off;
}

template <class Group, class... Extra>
void IncrementalSmoother<Group, Extra...>::estimate(Key key) {
  estimates_[key] = origins_[key].retract(matrix_of<Tangent>(solver_.solution(key).data()));
  costs_.change(key);
}

/// Moves the point at which a variable's factors are linearized, and its estimate with it.
template <class Group, class... Extra>
void IncrementalSmoother<Group, Extra...>::relinearize_at(Key key, const Group& origin) {
  origins_before_.push_back(origins_[key]);
  changes_.push_back({ChangeKind::origin_moved, key, look_[key]});
  waiting_.stop(key);
  look_[key] = options_.first_look;
  origins_[key] = origin;
  if constexpr (requires(Group & group) { group.normalize(); }) origins_[key].normalize();
  solver_.set_solution_zero(key);
  estimate(key);
  for (Index k = solver_.terms().first(key); k != -1; k = solver_.terms().slot(k).next)
    touch(solver_.terms().slot(k).term);
}

template <class Group, class... Extra>
void IncrementalSmoother<Group, Extra...>::touch(Index term) {
  if (touched_[term] != 0) return;
  touched_[term] = 1;
  touched_terms_.push_back(term);
}

template <class Group, class... Extra>
bool IncrementalSmoother<Group, Extra...>::linearize_touched(UpdateReport& report) {
  bool finite = true;
  for (const Index term : touched_terms_) {
    touched_[term] = 0;
    set_off(term, 0.0);
    if (!solver_.terms().linked(term)) continue;
    solver_.change_term(term);
    finite = write(term, report) && finite;
  }
  report.relinearized = to_index(touched_terms_.size());
  touched_terms_.clear();
  return finite;
}

template <class Group, class... Extra>
bool IncrementalSmoother<Group, Extra...>::linearize_added(UpdateReport& report) {
  bool finite = true;
  for (const Change& change : changes_) {
    if (change.kind != ChangeKind::factor_added) continue;
    touched_[change.id] = 0;
    if (solver_.terms().linked(change.id)) finite = write(change.id, report) && finite;
  }
  return finite;
}

/// Writes a factor's linearization into its term.
/// @returns false if it is not finite; the report then names its variables.
template <class Group, class... Extra>
bool IncrementalSmoother<Group, Extra...>::write(Index term, UpdateReport& report) {
  double* const numbers = solver_.jacobian(term);
  const Offset size = solver_.terms().size(term);
  pools_.linearize(term, origins_, numbers, size);
  double sum = 0.0;
  for (Offset k = 0; k < size; ++k) sum += std::abs(numbers[k]);
  if (std::isfinite(sum)) return true;
  list_keys(term, report.variables);
  return false;
}

/// Finds the factors that the step has carried too far from where they were linearized.
template <class Group, class... Extra>
void IncrementalSmoother<Group, Extra...>::look_at_changed(UpdateReport& report) {
  if (waiting_.count() == 0) waiting_gap_ = 0.0;  // but for rounding
  const double error = std::max(report.squared_error, options_.least_error);
  const double tolerated = options_.nonlinear_tolerance * error / std::max(1, pools_.count());
  for (const Key key : solver_.changed()) {
    const auto step = solver_.solution(key);
    double length = 0.0;
    for (const double coordinate : step) length = std::max(length, std::abs(coordinate));
    if (length <= look_[key]) continue;
    set_look(key, 1.5 * length);
    if (length > options_.longest_step) {
      wait(key);
      far_.push_back(key);
    }
    for (Index k = solver_.terms().first(key); k != -1; k = solver_.terms().slot(k).next)
      touch(solver_.terms().slot(k).term);
  }
  for (const Index term : touched_terms_) {
    touched_[term] = 0;
    const double off = misprediction(term);
    const bool waits = off > tolerated || options_.nonlinear_tolerance == 0.0;
    set_off(term, waits ? off : 0.0);
    if (!waits) continue;
    for (const auto& slot : solver_.terms().slots(term)) wait(slot.variable);
  }
  touched_terms_.clear();
  report.gap += waiting_gap_;
}

/// Squared distance between a factor's residual and what its linearization predicts.
template <class Group, class... Extra>
double IncrementalSmoother<Group, Extra...>::misprediction(Index term) {
  const Index rows = solver_.terms().rows(term);
  numbers_.resize(rows);
  pools_.residual(term, estimates_, numbers_.data(), rows);
  const double* predicted = solver_.terms().residual(term);
  const double* jacobian = solver_.terms().jacobian(term);
  double squared = 0.0;
  for (double& off : numbers_) {
    off -= *predicted++;
    for (const auto& slot : solver_.terms().slots(term)) {
      const double* const step = solver_.solution(slot.variable).data();
      for (int k = 0; k < dof; ++k) off -= *jacobian++ * step[k];
    }
    squared += off * off;
  }
  return squared;
}

template <class Group, class... Extra>
void IncrementalSmoother<Group, Extra...>::set_look(Key key, double look) {
  changes_.push_back({ChangeKind::looked, key, look_[key]});
  look_[key] = look;
}

}  // namespace chainslam

#ifdef CHAINSLAM_COMPILED
namespace chainslam {

extern template class IncrementalSmoother<SE3d>;
extern template UpdateReport IncrementalSmoother<SE3d>::update(const Serial&);
extern template ConvergeReport IncrementalSmoother<SE3d>::converge(const ConvergeOptions<>&, const Serial&);
extern template ConvergeReport IncrementalSmoother<SE3d>::converge(const ConvergeOptions<NoRestart>&, const Serial&);
extern template FactorId IncrementalSmoother<SE3d>::add(const PriorFactor<SE3d>&);
extern template FactorId IncrementalSmoother<SE3d>::add(const BetweenFactor<SE3d>&);

}  // namespace chainslam
#endif
