#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <utility>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/detail/candidate_list.hpp"
#include "chainslam/factor_graph/factors.hpp"
#include "chainslam/factor_graph/incremental_smoother.hpp"
#include "chainslam/factor_graph/smoother_reports.hpp"

namespace chainslam {

/// Set on three real drives of NCLT with sampled closures, right and wrong (test/slam/nclt_sessions_test.cpp).
struct IncrementalGncOptions {
  double growth = 2.0;   ///< of the control parameter, per step
  Index max_steps = 40;  ///< smoother updates per call
  /// Unexpected groups that agree with each other, so that it is tried what follows from them all: an outlier that was
  /// taken in, or a trusted factor that is wrong, makes all later ones unexpected.
  Index support = 2;
  /// Standard deviations of a measurement up to which the way between two may be uncertain, if they are to agree:
  /// farther apart, any two would.
  double max_blur = 10.0;
  Index memory = 50;               ///< unexpected groups that are remembered for that
  double consecutive_price = 0.1;  ///< fraction of its price that an outlier costs shortly after another
  Index consecutive_gap = 3;       ///< of the same sequence: so many places after it at most
  /// Rows of residuals of candidates near a change, the newest first, that an update tries the other way round.
  Index tried_rows = 600;
};

/// How a factor that may be wrong is judged.
struct OutlierTest {
  /// Squared whitened residual beyond which it is an outlier. 0: what one good factor in a hundred exceeds.
  double threshold = 0.0;
  /// What an outlier costs the truncated squares. 0: its threshold.
  double price = 0.0;
  /// What an outlier still counts. More than 0 for what alone may hold parts of the graph together.
  double outlier_weight = 0.0;
  bool begins_in = true;  ///< or as an outlier, as it was when it was saved
  /// Whether it begins as an outlier where the graph, by its own covariance, does not expect it: its error would be
  /// shared out over what is less certain, and never show.
  bool forecast = false;
  /// Whether it is taken as right until enough others agree that the graph is wrong.
  bool trusted = false;
  /// Number of the preceding candidate of a sequence that fails as a whole, such as steps of odometry: of consecutive
  /// outliers only the first costs its full price. -1: none.
  Index previous = -1;
};

/// What an update did.
struct IncrementalGncReport {
  UpdateReport last;       ///< of the last update
  Index steps = 0;         ///< updates,
  FactorizationWork work;  ///< and what all of them took
  bool decided = true;  ///< whether each candidate is in or out, as its residual says; else the steps did not suffice
};

/// Takes candidates into a growing graph, and decides again which of them are outliers whenever they contradict each
/// other or the rest, so that the truncated squares become least: squared whitened residuals of what is in, prices of
/// what is out. Three kinds of steps lower them:
/// - graduated non-convexity (Yang et al. 2020) where a residual says something else than its weight, each step an
///   update of the smoother (McGann, Rogers and Kaess 2023, "riSAM", where the steps are those of a scale-invariant
///   kernel);
/// - one group out or in, by what the smoother forecasts: an outlier that came early bends what is weaker than it, and
///   its residual does not show;
/// - several unexpected groups that agree with each other (Mangelson et al. 2018) in, whatever is found to contradict
///   them out; what does not lower the truncated squares is taken back.
///
/// A candidate counts in full until it is contradicted. Outliers count again when the estimate agrees with them.
/// Candidates that follow from one another form a group with one vote: it is in as long as half of it agrees with the
/// estimate, and then each member is judged by itself too. Without contradictions, an update costs what the smoother's
/// does and some forecasts. The smoother's own factors, or the weights of outliers, must constrain the whole graph.
template <class Smoother>
class IncrementalGnc {
 public:
  using Group = typename Smoother::Value;  ///< type of the variables
  using Candidate = BetweenFactor<Group>;  ///< the factor that is judged
  static constexpr Index none = -1;        ///< no candidate, no key

  /// @param smoother  stays the caller's, and outlives this.
  explicit IncrementalGnc(Smoother& smoother, const IncrementalGncOptions& options = {})
      : smoother_(smoother), options_(options) {}

  /// Adds a candidate to the smoother. @returns its number: 0, 1, ...
  /// @param leader  number of the candidate whose group it joins, the first of that group; none: a group of its own.
  [[gnu::cold]] Index add(const Candidate& candidate, const OutlierTest& test = {}, Index leader = none) {
    Entry entry;
    entry.factor = candidate;
    entry.threshold = test.threshold > 0.0 ? test.threshold : chi_squared_99(Group::dof);
    entry.price = test.price > 0.0 ? test.price : entry.threshold;
    entry.outlier_weight = test.outlier_weight;
    entry.trusted = test.trusted;
    entry.forecast = test.forecast;
    entry.leader = leader;
    entry.previous = test.previous;
    const Index number = candidates_.add(entry);
    if (test.forecast && test.begins_in)
      waiting_.push_back(number);
    else
      put(number, test.begins_in);
    return number;
  }

  /// Adds a candidate on one variable.
  Index add(const PriorFactor<Group>& prior, const OutlierTest& test = {}) {
    return add(Candidate{none, prior.key, prior.mean, prior.sqrt_information}, test);
  }

  /// Takes a candidate out for good.
  [[gnu::cold]] void remove(Index number) {
    Entry& of = candidates_[number];
    if (smoother_.contains(of.id)) smoother_.remove(of.id);
    of.ratio = 0.0;
    of.outdated = false;
  }

  /// Puts another measurement of the same variable in the place of a prior; it counts as that did.
  [[gnu::cold]] void replace(Index number, const Group& mean, const SqrtInformation<Group::dof>& sqrt_information) {
    Entry& of = candidates_[number];
    const bool in = is_in(number);
    smoother_.remove(of.id);
    of.factor.measurement = mean;
    of.factor.sqrt_information = sqrt_information;
    put(number, in);
  }

  /// Puts candidates that wait for a forecast into the smoother, in full: where nothing else holds what they hold.
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
  /// or not, be decided again by the next update.
  void vouch_for(Index leader) { vouched_for_.push_back(leader); }

  /// Lets the next update try whether a trusted factor is an outlier, for reasons of the caller's own.
  /// @param evidence  squared deviations against it that the graph does not know of: an outlier costs as much less, but
  ///                  what a consecutive one does at least. 0: nothing is against it any more.
  [[gnu::cold]] void lower_price(Index number, double evidence) {
    candidates_[number].discount = std::max(evidence, 0.0);
    if (number < settled_) measure(number);
  }
  /// Whether it is lower.
  [[nodiscard]] bool has_lower_price(Index number) const { return candidates_[number].discount > 0; }

  /// Updates the smoother until each candidate is in or out. If the first update fails, the candidates added since the
  /// last are gone, as all else; if a later one does, the decision waits for the next time.
  [[gnu::cold]] IncrementalGncReport update() {
    IncrementalGncReport report;
    changed_.clear();
    if (!step(report) || (!waiting_.empty() && (forecast(), !step(report)))) {
      drop_unsettled();
      return report;
    }
    for (Index number = settled_; number < candidates_.size(); ++number) measure(number);
    settled_ = candidates_.size();
    decide(report);
    try_others(report, options_.tried_rows, Serial{});
    try_unexpected(report);
    forget_touched();
    return report;
  }

  /// Measures all candidates again and decides: after the estimate was moved otherwise. Any executor decides the same.
  template <Executor Exec = Serial>
  [[gnu::cold]] IncrementalGncReport reconsider(const Exec& executor = {}) {
    IncrementalGncReport report;
    changed_.clear();
    for (Index number = 0; number < settled_; ++number) measure(number);
    decide(report);
    try_others(report, std::numeric_limits<Index>::max(), executor);
    while (report.last.ok() && report.steps < options_.max_steps && take_worst_trusted_out() && step(report)) {
      decide(report);
      try_others(report, std::numeric_limits<Index>::max(), executor);
    }
    try_trusted(report);
    forget_touched();
    return report;
  }

  /// Lets all steps of a sequence between two variables that candidates hold share the error of one that is out:
  /// nothing says which of them failed. Their weights are such that each errs as expected, until it is decided again.
  /// @returns whether there are any: the smoother is then to be updated.
  [[gnu::cold]] bool share_errors();

  /// Keys whose estimate the last call changed, some several times.
  [[nodiscard]] std::span<const Key> changed() const { return changed_.all(); }

  /// Candidates that got a weight since the last call.
  [[nodiscard]] [[gnu::cold]] detail::Table<Index> take_weighed() {
    for (const Index number : weighed_) candidates_[number].weighed = false;
    return std::exchange(weighed_, {});
  }

  /// A prior's `from` is none.
  [[nodiscard]] const Candidate& factor(Index number) const { return candidates_[number].factor; }
  /// Squared whitened residual beyond which a candidate is an outlier.
  [[nodiscard]] double threshold(Index number) const { return candidates_[number].threshold; }
  /// The factor's name in the smoother; none yet before the first update.
  [[nodiscard]] FactorId id(Index number) const { return candidates_[number].id; }
  /// Whether a candidate counts in full.
  [[nodiscard]] bool is_in(Index number) const { return smoother_.weight(id(number)) == 1.0; }

 private:
  using Entry = typename detail::CandidateList<Group>::Entry;
  using Trial = typename detail::CandidateList<Group>::Trial;
  static constexpr double decisive_mu = 1e6;

  [[gnu::cold]] void drop_unsettled();

  /// Graduated non-convexity, until nothing that was measured is contradicted.
  [[gnu::cold]] void decide(IncrementalGncReport& report);

  /// Trusted factors are judged only while all is decided again, and where they are out already.
  [[nodiscard]] bool is_judged(const Entry& one) const {
    return smoother_.contains(one.id) && !(trusting_ && one.trusted && smoother_.weight(one.id) == 1.0);
  }

  [[gnu::cold]] void put(Index number, bool in);

  /// Puts what waits into the smoother: as outliers what the graph does not expect.
  [[gnu::cold]] void forecast();

  /// Whether a candidate would be the only constraint on a segment of a sequence behind an outlier of it. Any
  /// measurement is consistent there, so that it must wait for a second one that agrees.
  [[nodiscard]] bool is_uncorroborated(const Candidate& factor) const {
    return factor.from != none && (is_on_loose_segment(factor.to) || is_on_loose_segment(factor.from));
  }
  [[nodiscard]] [[gnu::cold]] bool is_on_loose_segment(Key key) const;
  /// What a variable has of the sequence before and after it, and whether another candidate between two holds it.
  struct Surroundings {
    Index before = none, after = none;
    bool held = false;
  };
  [[nodiscard]] [[gnu::cold]] Surroundings around(Key key) const;

  /// The steps around one of a sequence, up to variables that candidates hold; none if the sequence ends before.
  [[nodiscard]] [[gnu::cold]] detail::Table<Index> between_held(Index step) const;

  /// Trusted factors are tried where they are out, next to those, and where their price is lower.
  [[nodiscard]] bool may_be_tried(Index leader) const {
    const Entry& one = candidates_[leader];
    return one.factor.from != none &&
           (one.forecast || one.discount > 0 || is_out(leader) || follows_one(leader) || is_out(one.next));
  }

  /// Takes single groups near a change out or in, each once, as long as the forecast says that the truncated squares
  /// fall.
  template <Executor Exec>
  [[gnu::cold]] void try_others(IncrementalGncReport& report, Index rows, const Exec& executor);
  /// Turns the first touched group for which the forecast says so. @param rows  of forecasts. @returns whether one was.
  template <Executor Exec>
  [[nodiscard]] [[gnu::cold]] bool turn_one(Index rows, const Exec& executor);
  /// Nothing where bounds say that the group stays as it is. @param rows  is lowered by those of the forecast.
  [[nodiscard]] [[gnu::cold]] std::optional<Trial> trial(Index leader, Index& rows);
  /// @returns whether the group was turned.
  [[nodiscard]] [[gnu::cold]] bool turn(const Trial& trial);
  /// Takes out the trusted factor without which the truncated squares fall the most, if they fall at all: where several
  /// share an error, none of them shows it. Only between two variables that candidates hold, since priors that are off
  /// together speak against any step. @returns whether there is one.
  [[nodiscard]] [[gnu::cold]] bool take_worst_trusted_out();
  /// Bounds the leverage of each candidate: most forecasts are then not needed.
  [[gnu::cold]] void bound_leverages();
  /// That bound; infinite if it is not known.
  [[nodiscard]] [[gnu::cold]] double leverage(Index number) const {
    return leverages_at_ == steps_ && number < leverages_.size() ? leverages_[number]
                                                                 : std::numeric_limits<double>::infinity();
  }
  /// Whether an earlier forecast for the same members already says that these stay as they are.
  [[nodiscard]] [[gnu::cold]] bool stays(Index leader, bool in, Index members, double squares, double limit) const;
  /// Tries what follows from groups that were vouched for, and from unexpected ones of which enough agree with a new
  /// one.
  [[gnu::cold]] void try_unexpected(IncrementalGncReport& report);
  /// Lets groups count in full and decides again on what speaks against them, first with what is trusted, then without;
  /// takes that back unless the truncated squares fall by more than `margin`.
  [[gnu::cold]] void try_in(std::span<const Index> leaders, double margin, IncrementalGncReport& report) {
    if (!try_in(leaders, margin, true, report)) static_cast<void>(try_in(leaders, margin, false, report));
  }
  /// @returns false if it was taken back.
  [[nodiscard]] [[gnu::cold]] bool try_in(std::span<const Index> leaders, double margin, bool trusting,
                                          IncrementalGncReport& report);
  /// Tries trusted factors that are out in again, those near each other in their sequence together as well: what speaks
  /// against them may be wrong, and in only because they are out.
  [[gnu::cold]] void try_trusted(IncrementalGncReport& report);
  [[nodiscard]] [[gnu::cold]] double truncated_squares();
  [[nodiscard]] bool is_out(Index number) const {
    return number != none && smoother_.contains(id(number)) && !is_in(number);
  }
  /// Whether one shortly before it in its sequence is out.
  [[nodiscard]] bool follows_one(Index number) const {
    Index before = candidates_[number].previous;
    for (Index k = 0; k < options_.consecutive_gap && before != none; ++k, before = candidates_[before].previous)
      if (is_out(before)) return true;
    return false;
  }
  /// What an outlier costs the truncated squares.
  [[nodiscard]] double price(const Entry& one, bool consecutive) const {
    return consecutive ? options_.consecutive_price * one.price
                       : std::max(one.price - one.discount, options_.consecutive_price * one.price);
  }
  /// What it adds to the truncated squares that some members of a group are out.
  [[nodiscard]] [[gnu::cold]] double price(Index leader, Offset members) const {
    const Entry& one = candidates_[leader];
    return price(one, follows_one(leader) || is_out(one.next)) * static_cast<double>(members) /
           candidates_.votes(leader);
  }

  void note_weighed(Index number) {
    if (!std::exchange(candidates_[number].weighed, true)) weighed_.push_back(number);
    if (is_out(number) && !std::exchange(candidates_[number].listed, true)) outliers_.push_back(number);
  }
  void set_weight(Index number, double weight) {
    if (trying_) weights_before_.push_back({smoother_.weight(id(number)), number});
    smoother_.set_weight(id(number), weight);
    note_weighed(number);
  }
  void set_in(Index number, bool in) { set_weight(number, in ? 1.0 : candidates_[number].outlier_weight); }

  [[nodiscard]] [[gnu::cold]] bool step(IncrementalGncReport& report) {
    report.last = smoother_.update();
    report.work += report.last.work;
    ++report.steps;
    if (!report.last.ok()) return false;
    ++steps_;
    changed_.append(smoother_.changed());
    unmeasured_.append(smoother_.changed());
    return true;
  }

  /// Candidates on what was changed, each once however many updates changed it.
  [[gnu::cold]] void measure_changed();

  /// A candidate that was removed from the smoother is never contradicted.
  [[gnu::cold]] void measure(Index number);
  /// Whether its residual decides nothing: a trusted one, by itself, that is in and not to be tried.
  [[nodiscard]] [[gnu::cold]] bool rests(Index number) const;
  /// Squared whitened residual over the threshold, of one that may have rested.
  [[nodiscard]] [[gnu::cold]] double ratio(Index number);

  [[gnu::cold]] void forget_touched() {
    for (const Ranked& one : touched_) candidates_[one.index].touched = candidates_[one.index].turned = false;
    touched_.clear();
  }

  /// Whether a candidate that was measured has not the weight that its residual asks for.
  [[nodiscard]] [[gnu::cold]] bool contradicted();

  /// @param mu  the control parameter; `decisive_mu`: in or out
  [[nodiscard]] [[gnu::cold]] double weight_of(const Entry& one, double of_group, double mu) const {
    const double ratio = std::max(candidates_.votes(one.leader) * one.ratio, of_group);
    const double weight = mu < decisive_mu ? truncated_weight(ratio, 1.0, mu) : (ratio <= 1.0 ? 1.0 : 0.0);
    return std::max(weight, one.outlier_weight);
  }

  [[nodiscard]] [[gnu::cold]] double first_mu() const;

  /// Gives the members of a group the weights that their residuals ask for.
  [[gnu::cold]] void weigh(Index leader, double mu);

  Smoother& smoother_;
  IncrementalGncOptions options_;
  detail::CandidateList<Group> candidates_;
  detail::Table<Index> watched_;   ///< leaders of groups measured since there was last no contradiction
  detail::Table<Ranked> touched_;  ///< leaders of groups that may be tried, measured by this call
  detail::Table<Key> changed_;
  detail::Table<Key> unmeasured_;         ///< changed since the candidates on them were measured
  detail::Table<Index> waiting_;          ///< to be put into the smoother by the next update
  detail::Table<Index> unexpected_;       ///< leaders of groups
  Index news_ = 0;                        ///< how many of these are new
  detail::Table<Index> vouched_for_;      ///< leaders
  detail::Table<Index> weighed_;          ///< since `take_weighed`
  detail::Table<Index> outliers_;         ///< those that are out, and some that were
  bool trying_ = false;                   ///< whether what is done may be taken back:
  detail::Table<Ranked> weights_before_;  ///< weights that candidates had, in the order of changes
  bool trusting_ = true;
  std::uint64_t steps_ = 0;          ///< updates so far
  detail::Table<double> leverages_;  ///< bounds, of each candidate,
  std::uint64_t leverages_at_ = 0;   ///< after so many updates
  Index settled_ = 0;                ///< candidates that have taken part in an update
};

}  // namespace chainslam

// Bodies of its members.
#include "chainslam/factor_graph/detail/incremental_gnc_decisions.hpp"
#include "chainslam/factor_graph/detail/incremental_gnc_trials.hpp"
