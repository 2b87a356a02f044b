#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <span>
#include <type_traits>
#include <utility>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/incremental_gnc.hpp"
#include "chainslam/factor_graph/outlier_rejection.hpp"

// How `IncrementalGnc` tries whether the truncated squares are less the other way round.

namespace chainslam {

template <class Smoother>
template <Executor Exec>
void IncrementalGnc<Smoother>::try_others(IncrementalGncReport& report, Index rows, const Exec& executor) {
  while (report.last.ok() && report.steps < options_.max_steps) {
    if (rows == std::numeric_limits<Index>::max()) bound_leverages();
    // Trusted ones that are out come first: each costs much. Then the newest.
    sort_ranked(touched_.all());
    if (!turn_one(rows, executor) || !step(report)) return;
    decide(report);
  }
}

template <class Smoother>
template <Executor Exec>
bool IncrementalGnc<Smoother>::turn_one(Index rows, const Exec& executor) {
  constexpr bool alone = std::is_same_v<Exec, Serial>;
  constexpr std::size_t at_once = alone ? 1 : 32;  // those behind one that is turned are made in vain
  std::vector<Trial> trials;
  for (Offset k = 0; k < touched_.size() && rows > 0;) {
    trials.clear();
    for (; k < touched_.size() && rows > 0 && trials.size() < at_once; ++k)
      if (auto one = trial(touched_[k].index, rows)) trials.push_back(std::move(*one));
    executor.for_chunks(to_index(trials.size()), 1, [&](Index begin, Index /*end*/) {
      Trial& one = trials[static_cast<std::size_t>(begin)];
      const std::span<const Candidate> together = one.members.all();
      one.forecast = one.in ? smoother_.fall_without(together) : smoother_.rise_with(together);
    });
    for (const Trial& one : trials) {
      if (turn(one)) return true;
    }
  }
  return false;
}

template <class Smoother>
typename IncrementalGnc<Smoother>::Surroundings IncrementalGnc<Smoother>::around(Key key) const {
  Surroundings found;
  candidates_.for_each_at(key, [&](Index number) {
    const Entry& one = candidates_[number];
    if (one.trusted)
      (one.factor.to == key ? found.before : found.after) = number;
    else
      found.held |= one.factor.from != none && smoother_.contains(one.id) && is_in(number);
  });
  return found;
}

template <class Smoother>
bool IncrementalGnc<Smoother>::is_on_loose_segment(Key key) const {
  const Surroundings start = around(key);
  Surroundings at = start;
  while (!at.held && at.after != none && !is_out(at.after)) at = around(factor(at.after).to);
  if (at.held) return false;
  at = start;
  while (!at.held && at.before != none && !is_out(at.before)) at = around(factor(at.before).from);
  return !at.held && at.before != none;
}

template <class Smoother>
detail::Table<Index> IncrementalGnc<Smoother>::between_held(Index step) const {
  detail::Table<Index> steps;
  for (Index one = step; !around(factor(one).from).held;) {
    one = around(factor(one).from).before;
    if (one == none) return {};
    steps.push_back(one);
  }
  steps.push_back(step);
  for (Index one = step; !around(factor(one).to).held;) {
    one = around(factor(one).to).after;
    if (one == none) return {};
    steps.push_back(one);
  }
  return steps;
}

template <class Smoother>
bool IncrementalGnc<Smoother>::share_errors() {
  constexpr double negligible = 0.05;
  bool any = false;
  for (Index number = 0; number < candidates_.size(); ++number) {
    const Entry& one = candidates_[number];
    if (!one.trusted || one.factor.from == none || !is_out(number)) continue;
    const detail::Table<Index> steps = between_held(number);
    if (steps.size() < 2) continue;
    double deviations = 0.0;
    bool known = false;  // which one it is
    for (const Index step : steps) known |= has_lower_price(step);
    if (known) continue;
    for (const Index step : steps)
      deviations += std::sqrt(candidates_.ratio_at(smoother_, step) * candidates_[step].threshold);
    const double each = deviations / static_cast<double>(steps.size());
    const double weight = std::min(Group::dof / (each * each), 1.0);
    if (std::abs(smoother_.weight(id(number)) - weight) < negligible * weight) continue;
    for (const Index step : steps) set_weight(step, weight);
    any = true;
  }
  return any;
}

template <class Smoother>
auto IncrementalGnc<Smoother>::trial(Index leader, Index& rows) -> std::optional<Trial> {
  if (candidates_[leader].turned || !may_be_tried(leader)) return std::nullopt;
  Trial trial{.leader = leader, .in = is_in(leader)};
  if (!trial.in && !candidates_[leader].trusted && is_uncorroborated(factor(leader))) return std::nullopt;
  double squares = 0.0, known = 0.0;
  candidates_.for_each_member(leader, [&](Index number) {
    if (!smoother_.contains(id(number)) || is_in(number) != trial.in) return;
    trial.members.push_back(candidates_[number].factor);
    squares += ratio(number) * candidates_[number].threshold;
    known += leverage(number);
  });
  const Index members = to_index(trial.members.size());
  rows -= members * Group::dof;
  trial.limit = price(leader, members);
  // The largest eigenvalue of all together is at most the sum of those of each.
  if (trial.in ? squares <= trial.limit * (1 - known) : squares >= trial.limit * (1 + known)) return std::nullopt;
  if (stays(leader, trial.in, members, squares, trial.limit)) return std::nullopt;
  return trial;
}

template <class Smoother>
bool IncrementalGnc<Smoother>::turn(const Trial& trial) {
  const bool in = trial.in;
  Entry& leader = candidates_[trial.leader];
  leader.forecasts = {trial.forecast.per_residual, smoother_.losses(), to_index(trial.members.size()), in};
  // Not a number where nothing else holds what they hold: neither.
  if (!(in ? trial.forecast.change > trial.limit : trial.forecast.change < trial.limit)) return false;
  candidates_.for_each_member(trial.leader, [&](Index number) {
    if (smoother_.contains(id(number)) && is_in(number) == in) set_in(number, !in);
  });
  leader.turned = true;
  if (in && !leader.trusted) unexpected_.push_back(trial.leader);
  return true;
}

template <class Smoother>
bool IncrementalGnc<Smoother>::take_worst_trusted_out() {
  bound_leverages();
  Index worst = none;
  double most = 0.0;
  for (Index number = 0; number < settled_; ++number) {
    const Entry& one = candidates_[number];
    if (!one.trusted || one.turned || !smoother_.contains(one.id) || !is_in(number)) continue;
    const double limit = price(one.leader, 1);
    if (ratio(number) * one.threshold <= limit * (1 - leverage(number)) || between_held(number).empty()) continue;
    const double fall = smoother_.fall_without(std::span(&one.factor, 1)).change - limit;
    if (!(fall > most)) continue;
    most = fall;
    worst = number;
  }
  if (worst == none) return false;
  set_in(worst, false);
  candidates_[worst].turned = true;
  if (!std::exchange(candidates_[worst].touched, true))
    touched_.push_back({-std::numeric_limits<double>::infinity(), worst});
  return true;
}

template <class Smoother>
void IncrementalGnc<Smoother>::bound_leverages() {
  if (leverages_at_ == steps_ && leverages_.size() == candidates_.size()) return;
  detail::Table<Index> numbers;
  for (Index number = 0; number < candidates_.size(); ++number) {
    if (factor(number).from != none && smoother_.contains(id(number))) numbers.push_back(number);
  }
  smoother_.commit();  // the inverse takes much memory too
  const auto bounds = typename Smoother::Leverages(smoother_).bounds(
      to_index(numbers.size()), [&](Index k) -> const Candidate& { return factor(numbers[k]); });
  leverages_.assign(candidates_.size(), std::numeric_limits<double>::infinity());
  for (Offset k = 0; k < numbers.size(); ++k) leverages_[numbers[k]] = bounds[k];
  leverages_at_ = steps_;
}

template <class Smoother>
bool IncrementalGnc<Smoother>::stays(Index leader, bool in, Index members, double squares, double limit) const {
  constexpr double margin = 1.25;  // for what relinearization has changed since
  const auto& known = candidates_[leader].forecasts;
  if (known.members != members || known.in != in || known.losses != smoother_.losses()) return false;
  const double bound = known.per_residual * squares;
  return in ? margin * bound <= limit : bound >= margin * limit;
}

template <class Smoother>
void IncrementalGnc<Smoother>::try_unexpected(IncrementalGncReport& report) {
  unexpected_.keep_if([&](Index leader) { return !is_in(leader); });
  if (const Offset forgotten = unexpected_.size() - options_.memory; forgotten > 0)
    unexpected_ = detail::Table<Index>(unexpected_.range(forgotten, unexpected_.size()));
  const detail::Table<Index> newest(
      unexpected_.range(std::max<Offset>(unexpected_.size() - std::exchange(news_, 0), 0), unexpected_.size()));
  for (const Index leader : std::exchange(vouched_for_, {}))  // alone: the rest must be explained as well as before
    try_in(std::span(&leader, 1), price(leader, candidates_[leader].members), report);
  detail::Table<Index> agreeing;
  for (const Index leader : newest) {
    agreeing.clear();
    for (const Index other : unexpected_)
      if (!is_in(other) && (other == leader || pairwise_consistent(smoother_, factor(other), factor(leader),
                                                                   candidates_[leader].threshold, options_.max_blur)))
        agreeing.push_back(other);
    if (agreeing.size() >= options_.support) try_in(agreeing.all(), 0.0, report);
  }
}

template <class Smoother>
bool IncrementalGnc<Smoother>::try_in(std::span<const Index> leaders, double margin, bool trusting,
                                      IncrementalGncReport& report) {
  if (!report.last.ok()) return true;
  const double before = truncated_squares();
  weights_before_.clear();
  trying_ = true;
  IncrementalGncReport trial;
  for (const Index leader : leaders) candidates_.for_each_member(leader, [&](Index number) { set_in(number, true); });
  trusting_ = trusting;
  if (step(trial)) decide(trial);
  trusting_ = true;
  try_others(trial, options_.tried_rows, Serial{});
  trying_ = false;
  report.steps += trial.steps;
  report.work += trial.work;
  report.last = trial.last;
  if (!trial.last.ok() || truncated_squares() < before - margin) return true;
  const detail::Table<Ranked> before_trial = std::exchange(weights_before_, {});
  for (Offset k = before_trial.size(); k-- > 0;) set_weight(before_trial[k].index, before_trial[k].rank);
  if (step(report)) decide(report);
  return false;
}

template <class Smoother>
void IncrementalGnc<Smoother>::try_trusted(IncrementalGncReport& report) {
  constexpr Index near = 10;  // places in the sequence
  detail::Table<Index> run;
  const auto attempt = [&] {
    const auto in = [&](std::span<const Index> some) { return try_in(some, 0.0, true, report); };
    if (!run.empty() && !in(run.all()) && run.size() > 1)
      for (const Index number : run)
        if (is_out(number)) static_cast<void>(in(std::span(&number, 1)));
    run.clear();
  };
  for (Index number = 0; number < candidates_.size(); ++number) {
    if (!candidates_[number].trusted || !is_out(number)) continue;
    if (!run.empty() && factor(number).to - factor(run.back()).to > near) attempt();
    run.push_back(number);
  }
  attempt();
}

template <class Smoother>
double IncrementalGnc<Smoother>::truncated_squares() {
  double sum = smoother_.current_cost();
  outliers_.keep_if([&](Index number) { return candidates_[number].listed = is_out(number); });
  for (const Index number : outliers_) {
    const Entry& one = candidates_[number];
    sum += price(one, follows_one(number)) / candidates_.votes(one.leader);
  }
  return sum;
}

}  // namespace chainslam
