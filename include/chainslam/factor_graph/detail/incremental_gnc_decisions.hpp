#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/incremental_gnc.hpp"

// How `IncrementalGnc` measures residuals and decides by them.

namespace chainslam {

template <class Smoother>
void IncrementalGnc<Smoother>::put(Index number, bool in) {
  Entry& of = candidates_[number];
  const Candidate& f = of.factor;
  const double weight = in ? 1.0 : of.outlier_weight;
  of.id = f.from == none ? smoother_.add(PriorFactor<Group>{f.to, f.measurement, f.sqrt_information}, weight)
                         : smoother_.add(f, weight);
  note_weighed(number);
}

template <class Smoother>
void IncrementalGnc<Smoother>::forecast() {
  for (const Index number : waiting_)
    candidates_[number].ratio = smoother_.what_if(candidates_[number].factor).rise / candidates_[number].threshold;
  for (const Index number : waiting_) {
    const Index leader = candidates_[number].leader;
    const bool in = weight_of(candidates_[number], candidates_.group_ratio(leader), decisive_mu) == 1.0 &&
                    !is_uncorroborated(candidates_[number].factor);
    put(number, in);
    if (!in && leader == number) {
      unexpected_.push_back(leader);
      ++news_;
    }
  }
  waiting_.clear();
}

template <class Smoother>
void IncrementalGnc<Smoother>::drop_unsettled() {
  const auto settled = [&](Index number) { return number < settled_; };
  watched_.keep_if(settled);
  unexpected_.keep_if(settled);
  weighed_.keep_if(settled);
  outliers_.keep_if(settled);
  touched_.keep_if([&](const Ranked& one) { return settled(one.index); });
  news_ = 0;
  waiting_.clear();
  while (candidates_.size() > settled_) candidates_.drop_last();
}

template <class Smoother>
void IncrementalGnc<Smoother>::measure_changed() {
  for (const Key key : std::exchange(unmeasured_, {}))
    candidates_.for_each_at(key, [&](Index number) {
      if (std::exchange(candidates_[number].measured, steps_) != steps_) measure(number);
    });
}

template <class Smoother>
void IncrementalGnc<Smoother>::measure(Index number) {
  Entry& of = candidates_[number];
  of.outdated = rests(number);
  if (of.outdated) return;
  of.ratio = smoother_.contains(of.id) ? candidates_.ratio_at(smoother_, number) : 0.0;
  if (!smoother_.contains(of.id)) return;
  Entry& leader = candidates_[of.leader];
  if (!std::exchange(leader.watched, true)) watched_.push_back(of.leader);
  if (may_be_tried(of.leader) && !std::exchange(leader.touched, true))
    touched_.push_back({leader.trusted ? -std::numeric_limits<double>::infinity() : -1.0 * of.leader, of.leader});
}

template <class Smoother>
bool IncrementalGnc<Smoother>::rests(Index number) const {
  const Entry& one = candidates_[number];
  return trusting_ && one.trusted && one.leader == number && one.members == 1 && smoother_.contains(one.id) &&
         is_in(number) && !may_be_tried(number);
}

template <class Smoother>
double IncrementalGnc<Smoother>::ratio(Index number) {
  Entry& of = candidates_[number];
  if (std::exchange(of.outdated, false)) of.ratio = candidates_.ratio_at(smoother_, number);
  return of.ratio;
}

template <class Smoother>
void IncrementalGnc<Smoother>::decide(IncrementalGncReport& report) {
  double mu = 0.0;
  while (contradicted()) {
    report.decided = report.steps < options_.max_steps;
    mu = mu > 0.0 ? options_.growth * mu : first_mu();
    for (const Index leader : watched_) weigh(leader, report.decided ? mu : decisive_mu);
    if (!step(report) || !report.decided) break;
  }
}

template <class Smoother>
bool IncrementalGnc<Smoother>::contradicted() {
  measure_changed();
  for (const Index leader : watched_) {
    const double of_group = candidates_.group_ratio(leader);
    bool found = false;
    candidates_.for_each_member(leader, [&](Index number) {
      const Entry& one = candidates_[number];
      found |= is_judged(one) && smoother_.weight(one.id) != weight_of(one, of_group, decisive_mu);
    });
    if (found) return true;
  }
  for (const Index leader : watched_) candidates_[leader].watched = false;
  watched_.clear();
  return false;
}

template <class Smoother>
double IncrementalGnc<Smoother>::first_mu() const {
  double largest = 1.0;
  for (const Index leader : watched_) {
    candidates_.for_each_member(leader, [&](Index number) {
      const Entry& one = candidates_[number];
      const bool is_weighed = is_judged(one) && smoother_.weight(one.id) > one.outlier_weight;
      if (is_weighed) largest = std::max(largest, candidates_.votes(leader) * one.ratio);
    });
  }
  return 1.0 / (2.0 * largest - 1.0);
}

template <class Smoother>
void IncrementalGnc<Smoother>::weigh(Index leader, double mu) {
  const double of_group = candidates_.group_ratio(leader);
  candidates_.for_each_member(leader, [&](Index number) {
    const Entry& of = candidates_[number];
    if (!is_judged(of)) return;
    const double next = weight_of(of, of_group, mu);
    if (std::abs(next - smoother_.weight(of.id)) > 1e-3 || next == of.outlier_weight || next == 1.0)
      set_weight(number, next);
  });
}

}  // namespace chainslam
