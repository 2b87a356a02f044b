#pragma once

#include <algorithm>
#include <cmath>
#include <span>
#include <utility>

#include "chainslam/core/ranked.hpp"
#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/square_matrix.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/between_factor.hpp"
#include "chainslam/factor_graph/incremental_smoother.hpp"
#include "chainslam/factor_graph/prior_factor.hpp"

namespace chainslam {

struct IncrementalGncOptions {
  double growth = 2.0;  ///< of the control parameter, a step
  Index max_steps = 40;
  /// Unexpected groups that agree with each other, so that all is decided anew: an outlier that was taken in, or a
  /// trusted factor that is wrong, makes all later ones unexpected.
  Index support = 3;
  /// Standard deviations of a measurement up to which the way between two may be uncertain, if they are to agree:
  /// farther apart, any two would.
  double max_blur = 10.0;
  Index memory = 50;  ///< unexpected groups that are remembered for that
};

/// How a factor that may be wrong is judged.
struct Suspicion {
  /// Squared whitened residual beyond which it is an outlier. 0: what one good factor in a hundred exceeds.
  double threshold = 0.0;
  /// What an outlier still counts. More than 0 for what alone may hold parts of the graph together.
  double outlier_weight = 0.0;
  bool begins_in = true;  ///< or as an outlier, as it was when it was saved
  /// Whether it begins as an outlier where the graph, by its own covariance, does not expect it: its error would be
  /// shared out over what is less certain, and never show.
  bool forecast = false;
  /// Whether it is beyond suspicion until enough others agree that the graph is wrong.
  bool trusted = false;
};

struct IncrementalGncReport {
  UpdateReport last;    ///< of the last update
  Index steps = 0;      ///< updates
  bool decided = true;  ///< whether each suspect is in or out, as its residual says; else the steps did not suffice
};

/// Takes suspects into a growing graph, and decides again which of them are outliers whenever they contradict each
/// other or the rest: graduated non-convexity with truncated least squares (Yang et al. 2020) where the contradiction
/// is, each step an update of the smoother (McGann, Rogers and Kaess 2023, "riSAM", where the steps are those of a
/// scale-invariant kernel).
///
/// A suspect counts in full until it is contradicted. Outliers count again when the estimate comes to agree with them.
/// Suspects that follow from one another form a group, which is in as long as half of it agrees with the estimate: one
/// vote, however many they are; of a group that is in, each is judged by itself too. Where nothing contradicts, an
/// update costs what the smoother's does. Factors beyond suspicion, which are given to the smoother itself, or the
/// weights of outliers must hold the graph together.
template <class Smoother>
class IncrementalGnc {
 public:
  using Group = typename Smoother::Value;
  using Suspect = BetweenFactor<Group>;
  static constexpr Index none = -1;  ///< no suspect, no key

  /// @param smoother  stays the caller's, and outlives this.
  explicit IncrementalGnc(Smoother& smoother, const IncrementalGncOptions& options = {})
      : smoother_(smoother), options_(options) {}

  /// Adds a suspect to the smoother. @returns its number: 0, 1, ...
  /// @param leader  number of the suspect whose group it joins, the first of that group; none: a group of its own.
  [[gnu::cold]] Index add(const Suspect& suspect, const Suspicion& suspicion = {}, Index leader = none) {
    const Index number = to_index(suspects_.size());
    Entry& added = suspects_.emplace_back();
    added.factor = suspect;
    added.threshold = suspicion.threshold > 0.0 ? suspicion.threshold : chi_squared_99(Group::dof);
    added.outlier_weight = suspicion.outlier_weight;
    added.trusted = suspicion.trusted;
    added.leader = leader == none ? number : leader;
    Entry& first = suspects_[added.leader];
    added.before = std::exchange(first.newest, number);
    ++first.members;
    added.older_at_to = note(suspect.to, number);
    if (suspect.from != none) added.older_at_from = note(suspect.from, number);
    if (suspicion.forecast && suspicion.begins_in)
      waiting_.push_back(number);
    else
      put(number, suspicion.begins_in);
    return number;
  }

  /// Adds a suspect on one variable.
  Index add(const PriorFactor<Group>& prior, const Suspicion& suspicion = {}) {
    return add(Suspect{none, prior.key, prior.mean, prior.sqrt_information}, suspicion);
  }

  /// Takes a suspect out for good.
  [[gnu::cold]] void remove(Index number) {
    Entry& of = suspects_[number];
    if (smoother_.contains(of.id)) smoother_.remove(of.id);
    of.ratio = 0.0;
  }

  /// Puts another measurement of the same variable in the place of a prior; it counts as that did.
  [[gnu::cold]] void replace(Index number, const Group& mean, const SqrtInformation<Group::dof>& sqrt_information) {
    Entry& of = suspects_[number];
    const bool in = is_in(number);
    smoother_.remove(of.id);
    of.factor.measurement = mean;
    of.factor.sqrt_information = sqrt_information;
    put(number, in);
  }

  /// Puts suspects that wait for a forecast into the smoother, in full: where nothing else holds what they hold.
  /// @returns whether there were any.
  [[gnu::cold]] bool admit() {
    const bool any = !waiting_.empty();
    for (const Index number : waiting_) put(number, true);
    waiting_.clear();
    return any;
  }

  /// Leaders of groups that the graph did not expect and that are still out, the newest last.
  [[nodiscard]] std::span<const Index> unexpected() const { return unexpected_.all(); }
  /// Lets an unexpected group count in full, for reasons of the caller's own, and all that speaks against it, trusted
  /// or not, be decided anew by the next update.
  void vouch_for(Index leader) { vouched_for_.push_back(leader); }

  /// Updates the smoother until each suspect is in or out. If the first update fails, the suspects added since the last
  /// are gone, as all else; if a later one does, the decision waits for the next time.
  [[gnu::cold]] IncrementalGncReport update() {
    IncrementalGncReport report;
    changed_.clear();
    if (!step(report) || (!waiting_.empty() && (forecast(), !step(report)))) {
      while (to_index(suspects_.size()) > settled_) drop_last();
      waiting_.clear();
      return report;
    }
    for (Index number = settled_; number < to_index(suspects_.size()); ++number) measure(number);
    settled_ = to_index(suspects_.size());
    decide(report);
    if (report.last.ok() && take_back() && step(report)) {
      trusting_ = false;
      decide(report);
      trusting_ = true;
    }
    return report;
  }

  /// Measures all suspects anew and decides: after the estimate was moved otherwise.
  [[gnu::cold]] IncrementalGncReport reconsider() {
    IncrementalGncReport report;
    changed_.clear();
    for (Index number = 0; number < settled_; ++number) measure(number);
    decide(report);
    return report;
  }

  /// Keys whose estimate the last call changed, some several times.
  [[nodiscard]] std::span<const Key> changed() const { return changed_.all(); }

  /// A prior's `from` is none.
  [[nodiscard]] const Suspect& factor(Index number) const { return suspects_[number].factor; }
  /// The factor's name in the smoother; none yet before the first update.
  [[nodiscard]] FactorId id(Index number) const { return suspects_[number].id; }
  /// Whether a suspect counts in full.
  [[nodiscard]] bool is_in(Index number) const { return smoother_.weight(id(number)) == 1.0; }

 private:
  using Jacobian = typename Group::Jacobian;
  static constexpr double decisive_mu = 1e6;

  struct Entry {
    FactorId id{};
    Suspect factor{};
    double threshold = 0.0, outlier_weight = 0.0;
    double ratio = 0.0;  ///< squared whitened residual at the estimate over the threshold
    bool trusted = false;
    bool watched = false;  ///< a leader: measured since there was last no contradiction
    Index leader = none;
    Index members = 0, newest = none;  ///< of a leader's group
    Index before = none;               ///< in its group
    Index older_at_to = none, older_at_from = none;
  };

  /// Calls visit(member's number) for a group, the newest first.
  template <class Visit>
  void for_each_member(Index leader, Visit&& visit) const {
    for (Index number = suspects_[leader].newest; number != none; number = suspects_[number].before) visit(number);
  }
  /// @returns the one that was noted at this key before, if any.
  [[nodiscard]] Index note(Key key, Index number) {
    if (key >= newest_at_.size()) newest_at_.resize(key + 1, none);
    return std::exchange(newest_at_[key], number);
  }

  void drop_last() {
    const Entry& last = suspects_.back();
    if (last.factor.from != none) newest_at_[last.factor.from] = last.older_at_from;
    newest_at_[last.factor.to] = last.older_at_to;
    suspects_[last.leader].newest = last.before;
    --suspects_[last.leader].members;
    suspects_.pop_back();
  }

  void decide(IncrementalGncReport& report) {
    double mu = 0.0;
    while (contradicted()) {
      report.decided = report.steps < options_.max_steps;
      mu = mu > 0.0 ? options_.growth * mu : first_mu();
      for (const Index leader : watched_) weigh(leader, report.decided ? mu : decisive_mu);
      if (!step(report) || !report.decided) break;
    }
  }

  /// Trusted factors are judged only while all is decided anew, and where they are out already.
  [[nodiscard]] bool is_judged(const Entry& one) const {
    return smoother_.contains(one.id) && !(trusting_ && one.trusted && smoother_.weight(one.id) == 1.0);
  }

  void put(Index number, bool in) {
    Entry& of = suspects_[number];
    const Suspect& f = of.factor;
    of.id =
        f.from == none ? smoother_.add(PriorFactor<Group>{f.to, f.measurement, f.sqrt_information}) : smoother_.add(f);
    if (!in) smoother_.set_weight(of.id, of.outlier_weight);
  }

  /// Puts what waits into the smoother: as outliers what the graph does not expect.
  void forecast() {
    for (const Index number : waiting_)
      suspects_[number].ratio = smoother_.what_if(suspects_[number].factor).rise / suspects_[number].threshold;
    for (const Index number : waiting_) {
      const Index leader = suspects_[number].leader;
      const bool in = weight_of(suspects_[number], group_ratio(leader), decisive_mu) == 1.0;
      put(number, in);
      if (!in && leader == number) {
        unexpected_.push_back(leader);
        ++news_;
      }
    }
    waiting_.clear();
  }

  /// Lets groups count in full that were vouched for, and unexpected ones of which enough agree with a new one.
  /// @returns whether there were any.
  [[nodiscard]] bool take_back() {
    unexpected_.keep_if([&](Index leader) { return !is_in(leader); });
    if (const Offset forgotten = unexpected_.size() - options_.memory; forgotten > 0)
      unexpected_ = detail::Table<Index>(unexpected_.range(forgotten, unexpected_.size()));
    detail::Table<Index> back = std::exchange(vouched_for_, {});
    for (Offset k = std::max<Offset>(unexpected_.size() - std::exchange(news_, 0), 0); k < unexpected_.size(); ++k) {
      detail::Table<Index> agreeing;
      for (const Index other : unexpected_)
        if (other == unexpected_[k] || agree(suspects_[other], suspects_[unexpected_[k]])) agreeing.push_back(other);
      if (agreeing.size() >= options_.support) back.append(agreeing.all());
    }
    for (const Index leader : back)
      for_each_member(leader, [&](Index number) { smoother_.set_weight(id(number), 1.0); });
    return !back.empty();
  }

  [[nodiscard]] static Jacobian noise(const Suspect& factor) {
    const Jacobian root = matrix_of<Jacobian>(factor.sqrt_information.data());
    const Jacobian inverse = solved_right(identity<Jacobian>(), cholesky(transposed_product(root, root)));
    return product_transposed(inverse, inverse);
  }
  [[nodiscard]] static Jacobian carried(const Jacobian& covariance, const Group& T) {
    return congruent(T.adjoint(), covariance);
  }

  /// Whether two measurements agree, by the ways that the estimate knows between their ends: pairwise consistency
  /// (Mangelson et al. 2018).
  [[nodiscard]] bool agree(const Entry& a, const Entry& b) const {
    const Suspect &one = a.factor, &other = b.factor;
    if (one.to == other.to || one.from == none || other.from == none) return false;  // of one scan: no second opinion
    const Group T_to = smoother_[one.to].inverse() * smoother_[other.to];
    const Group T_from = smoother_[one.from].inverse() * smoother_[other.from];
    auto error = ((T_from * other.measurement).inverse() * (one.measurement * T_to)).log();
    const Jacobian of_noise = sum_of(noise(other), carried(noise(one), T_to.inverse()));
    const Jacobian of_ways =
        sum_of(smoother_.relative_covariance(one.to, other.to),
               carried(smoother_.relative_covariance(one.from, other.from), other.measurement.inverse()));
    Jacobian covariance = sum_of(of_noise, of_ways);
    const Jacobian blur = congruent(matrix_of<Jacobian>(other.sqrt_information.data()), covariance);
    double squares = 0.0;
    for (int k = 0; k < Group::dof; ++k) squares += blur(k, k);
    if (!(squares <= Group::dof * options_.max_blur * options_.max_blur)) return false;  // anything would agree
    return squared_mahalanobis(covariance.data(), error.data(), Group::dof) <= std::min(a.threshold, b.threshold);
  }

  [[nodiscard]] bool step(IncrementalGncReport& report) {
    report.last = smoother_.update();
    ++report.steps;
    if (!report.last.ok()) return false;
    for (const Key key : smoother_.changed()) {
      changed_.push_back(key);
      if (key >= newest_at_.size()) continue;
      for (Index number = newest_at_[key]; number != none;) {
        measure(number);
        const Entry& one = suspects_[number];
        number = one.factor.to == key ? one.older_at_to : one.older_at_from;
      }
    }
    return true;
  }

  /// A suspect that was removed from the smoother is never contradicted.
  void measure(Index number) {
    Entry& of = suspects_[number];
    const Suspect& factor = of.factor;
    of.ratio = 0.0;
    if (!smoother_.contains(of.id)) return;
    const Group T_from_to =
        factor.from == none ? smoother_[factor.to] : smoother_[factor.from].inverse() * smoother_[factor.to];
    const auto residual =
        whitened<Group::dof, 1>(factor.sqrt_information, (factor.measurement.inverse() * T_from_to).log());
    for (int k = 0; k < Group::dof; ++k) of.ratio += residual[k] * residual[k] / of.threshold;
    if (!std::exchange(suspects_[of.leader].watched, true)) watched_.push_back(of.leader);
  }

  /// Members of a group share their information: m of them, half of it common, know as much as 2 m / (m + 1) alone.
  [[nodiscard]] double votes(Index leader) const { return 0.5 * (suspects_[leader].members + 1); }

  /// What half of a group does not exceed.
  [[nodiscard]] double group_ratio(Index leader) {
    if (suspects_[leader].members == 1) return suspects_[leader].ratio;
    ratios_.clear();
    for_each_member(leader, [&](Index number) { ratios_.push_back({suspects_[number].ratio, number}); });
    sort_ranked(ratios_.all());
    return votes(leader) * ratios_[(ratios_.size() - 1) / 2].rank;
  }

  /// Whether a suspect that was measured has not the weight that its residual asks for.
  [[nodiscard]] bool contradicted() {
    for (const Index leader : watched_) {
      const double of_group = group_ratio(leader);
      bool found = false;
      for_each_member(leader, [&](Index number) {
        const Entry& one = suspects_[number];
        found |= is_judged(one) && smoother_.weight(one.id) != weight_of(one, of_group, decisive_mu);
      });
      if (found) return true;
    }
    for (const Index leader : watched_) suspects_[leader].watched = false;
    watched_.clear();
    return false;
  }

  /// @param mu  the control parameter; `decisive_mu`: in or out
  [[nodiscard]] double weight_of(const Entry& one, double of_group, double mu) const {
    const double ratio = std::max(votes(one.leader) * one.ratio, of_group);
    const double weight = mu < decisive_mu ? truncated_weight(ratio, 1.0, mu) : (ratio <= 1.0 ? 1.0 : 0.0);
    return std::max(weight, one.outlier_weight);
  }

  [[nodiscard]] double first_mu() const {
    double largest = 1.0;
    for (const Index leader : watched_) {
      for_each_member(leader, [&](Index number) {
        const Entry& one = suspects_[number];
        const bool is_weighed = is_judged(one) && smoother_.weight(one.id) > one.outlier_weight;
        if (is_weighed) largest = std::max(largest, votes(leader) * one.ratio);
      });
    }
    return 1.0 / (2.0 * largest - 1.0);
  }

  void weigh(Index leader, double mu) {
    const double of_group = group_ratio(leader);
    for_each_member(leader, [&](Index number) {
      const Entry& of = suspects_[number];
      if (!is_judged(of)) return;
      const double next = weight_of(of, of_group, mu);
      if (std::abs(next - smoother_.weight(of.id)) > 1e-3 || next == of.outlier_weight || next == 1.0)
        smoother_.set_weight(of.id, next);
    });
  }

  Smoother& smoother_;
  IncrementalGncOptions options_;
  detail::Table<Entry> suspects_;
  detail::Table<Index> newest_at_;  ///< of each key, none where there is none
  detail::Table<Index> watched_;    ///< leaders
  detail::Table<Key> changed_;
  detail::Table<Ranked> ratios_;      ///< room for one group's
  detail::Table<Index> waiting_;      ///< to be put into the smoother by the next update
  detail::Table<Index> unexpected_;   ///< leaders of groups
  Index news_ = 0;                    ///< how many of these are new
  detail::Table<Index> vouched_for_;  ///< leaders
  bool trusting_ = true;
  Index settled_ = 0;  ///< suspects that have taken part in an update
};

}  // namespace chainslam
