#pragma once

#include <algorithm>
#include <cstdint>
#include <utility>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/detail/factor_places.hpp"
#include "chainslam/factor_graph/factors.hpp"
#include "chainslam/factor_graph/smoother_reports.hpp"

namespace chainslam::detail {

/// Factors that may be wrong, in groups of those that follow from one another, and by the keys that they are on.
template <class Group>
class CandidateList {
 public:
  static constexpr Index none = -1;

  /// What was last forecast for the members of a group that are alike in or out (`JointForecast::per_residual`).
  struct Forecast {
    double per_residual = 0.0;
    std::uint64_t losses = 0;  ///< of the smoother by then
    Index members = 0;         ///< how many they were
    bool in = false;
  };

  /// What is asked before a group is turned: taken out, or in.
  struct Trial {
    Index leader = none;
    bool in = false;     ///< as it is
    double limit = 0.0;  ///< what the squares have to fall by without it, or may rise by with it
    Table<BetweenFactor<Group>> members{};
    JointForecast forecast{};
  };

  struct Entry {
    FactorId id{};
    BetweenFactor<Group> factor{};  ///< `from` is none if it is on one variable
    double threshold = 0.0;         ///< of the squared whitened residual
    double price = 0.0;             ///< what an outlier costs the truncated squares
    double outlier_weight = 0.0;
    double ratio = 0.0;     ///< squared whitened residual at the estimate over the threshold
    double discount = 0.0;  ///< taken off the price
    bool trusted = false;   ///< not judged by its residual alone
    bool forecast = false;  ///< whether it is judged by what the graph says without it
    bool watched = false, touched = false, turned = false;  ///< marks of a leader
    bool weighed = false;                                   ///< whether it got a weight since somebody asked
    bool listed = false;                                    ///< among outliers
    bool outdated = false;                                  ///< whether `ratio` is that of an earlier estimate
    Index previous = none, next = none;                     ///< in a sequence, such as steps of odometry
    Index leader = none;                                    ///< of its group
    Index members = 0, newest = none;                       ///< of a leader's group
    Index before = none;                                    ///< in its group
    Index older_at_to = none, older_at_from = none;
    std::uint64_t measured = 0;  ///< the update for which `ratio` was last computed
    Forecast forecasts{};        ///< of a leader's group
  };

  [[nodiscard]] Entry& operator[](Index number) { return entries_[number]; }
  [[nodiscard]] const Entry& operator[](Index number) const { return entries_[number]; }
  [[nodiscard]] Index size() const { return to_index(entries_.size()); }

  /// Adds an entry, whose factor and leader are set. @returns its number.
  [[gnu::cold]] Index add(const Entry& entry) {
    const Index number = size();
    entries_.push_back(entry);
    Entry& added = entries_.back();
    if (added.leader == none) added.leader = number;
    if (added.previous != none) entries_[added.previous].next = number;
    Entry& first = entries_[added.leader];
    added.before = std::exchange(first.newest, number);
    ++first.members;
    added.older_at_to = note(added.factor.to, number);
    if (added.factor.from != none) added.older_at_from = note(added.factor.from, number);
    return number;
  }

  [[gnu::cold]] void drop_last() {
    const Entry& last = entries_.back();
    if (last.previous != none) entries_[last.previous].next = none;
    if (last.factor.from != none) newest_at_[last.factor.from] = last.older_at_from;
    newest_at_[last.factor.to] = last.older_at_to;
    entries_[last.leader].newest = last.before;
    --entries_[last.leader].members;
    entries_.pop_back();
  }

  /// Calls visit(number) for the members of a group, the newest first.
  template <class Visit>
  void for_each_member(Index leader, Visit&& visit) const {
    for (Index number = entries_[leader].newest; number != none; number = entries_[number].before) visit(number);
  }

  /// Calls visit(number) for all on a variable, the newest first.
  template <class Visit>
  void for_each_at(Key key, Visit&& visit) const {
    if (key >= newest_at_.size()) return;
    for (Index number = newest_at_[key]; number != none;) {
      const Entry& one = entries_[number];
      visit(number);
      number = one.factor.to == key ? one.older_at_to : one.older_at_from;
    }
  }

  /// Squared whitened residual over the threshold.
  template <class Estimate>
  [[nodiscard]] [[gnu::cold]] double ratio_at(const Estimate& estimate, Index number) const {
    const Entry& of = entries_[number];
    const BetweenFactor<Group>& factor = of.factor;
    const Group T_from_to =
        factor.from == none ? estimate[factor.to] : estimate[factor.from].inverse() * estimate[factor.to];
    const auto residual =
        whitened<Group::dof, 1>(factor.sqrt_information, (factor.measurement.inverse() * T_from_to).log());
    double squared = 0.0;
    for (int k = 0; k < Group::dof; ++k) squared += residual[k] * residual[k] / of.threshold;
    return squared;
  }

  /// How many times more strictly a member is judged than alone: members share their information, and m of them, half
  /// of it common, know as much as 2 m / (m + 1) alone.
  [[nodiscard]] double votes(Index leader) const { return 0.5 * (entries_[leader].members + 1); }

  /// What half of a group's ratios do not exceed, times its votes.
  [[nodiscard]] [[gnu::cold]] double group_ratio(Index leader) {
    if (entries_[leader].members == 1) return entries_[leader].ratio;
    ratios_.clear();
    for_each_member(leader, [&](Index number) { ratios_.push_back({entries_[number].ratio, number}); });
    sort_ranked(ratios_.all());
    return votes(leader) * ratios_[(ratios_.size() - 1) / 2].rank;
  }

 private:
  /// @returns the one that was noted at this key before, if any.
  [[nodiscard]] Index note(Key key, Index number) {
    if (key >= newest_at_.size()) newest_at_.resize(key + 1, none);
    return std::exchange(newest_at_[key], number);
  }

  Table<Entry> entries_;
  Table<Index> newest_at_;  ///< of each key, none where there is none
  Table<Ranked> ratios_;    ///< workspace of `group_ratio`
};

}  // namespace chainslam::detail
