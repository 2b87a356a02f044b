#pragma once

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <span>
#include <unordered_map>
#include <utility>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/between_factor.hpp"
#include "chainslam/factor_graph/graduated_non_convexity.hpp"
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
  std::size_t memory = 50;  ///< unexpected groups that are remembered for that
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

  /// @param smoother  stays the caller's, and outlives this.
  explicit IncrementalGnc(Smoother& smoother, const IncrementalGncOptions& options = {})
      : smoother_(smoother), options_(options) {}

  /// Adds a suspect to the smoother. @returns its number: 0, 1, ...
  /// @param leader  number of the suspect whose group it joins, the first of that group; none: a group of its own.
  Index add(const Suspect& suspect, const Suspicion& suspicion = {}, Index leader = none) {
    const Index number = to_index(suspects_.size());
    const double threshold = suspicion.threshold > 0.0 ? suspicion.threshold : chi_squared_99(Group::dof);
    if (leader == none) leader = number;
    suspects_.push_back({{}, suspect, threshold, suspicion.outlier_weight, leader, {}, 0.0, suspicion.trusted});
    entry(leader).members.push_back(number);
    of_key_[suspect.to].push_back(number);
    if (suspect.from != none) of_key_[suspect.from].push_back(number);
    if (suspicion.forecast && suspicion.begins_in)
      waiting_.push_back(number);
    else
      put(number, suspicion.begins_in);
    return number;
  }
  static constexpr Index none = -1;  ///< no suspect, no key

  /// Adds a suspect on one variable.
  Index add(const PriorFactor<Group>& prior, const Suspicion& suspicion = {}) {
    return add(Suspect{none, prior.key, prior.mean, prior.sqrt_information}, suspicion);
  }

  /// Takes a suspect out for good.
  void remove(Index number) {
    Entry& of = entry(number);
    if (smoother_.contains(of.id)) smoother_.remove(of.id);
    of.ratio = 0.0;
  }

  /// Puts another measurement of the same variable in the place of a prior; it counts as that did.
  void replace(Index number, const Group& mean, const SqrtInformation<Group::dof>& sqrt_information) {
    Entry& of = entry(number);
    const bool in = is_in(number);
    smoother_.remove(of.id);
    of.factor.measurement = mean;
    of.factor.sqrt_information = sqrt_information;
    put(number, in);
  }

  /// Puts suspects that wait for a forecast into the smoother, in full: where nothing else holds what they hold.
  /// @returns whether there were any.
  bool admit() {
    for (const Index number : waiting_) put(number, true);
    return !std::exchange(waiting_, {}).empty();
  }

  /// Leaders of groups that the graph did not expect and that are still out, the newest last.
  [[nodiscard]] std::span<const Index> unexpected() const { return unexpected_; }
  /// Lets an unexpected group count in full, for reasons of the caller's own, and all that speaks against it, trusted
  /// or not, be decided anew by the next update.
  void vouch_for(Index leader) { vouched_for_.push_back(leader); }

  /// Updates the smoother until each suspect is in or out. If the first update fails, the suspects added since the last
  /// are gone, as all else; if a later one does, the decision waits for the next time.
  IncrementalGncReport update() {
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
  IncrementalGncReport reconsider() {
    IncrementalGncReport report;
    changed_.clear();
    for (Index number = 0; number < settled_; ++number) measure(number);
    decide(report);
    return report;
  }

  /// Keys whose estimate the last call changed, some several times.
  [[nodiscard]] std::span<const Key> changed() const { return changed_; }

  /// A prior's `from` is none.
  [[nodiscard]] const Suspect& factor(Index number) const { return entry(number).factor; }
  /// The factor's name in the smoother; none yet before the first update.
  [[nodiscard]] FactorId id(Index number) const { return entry(number).id; }
  /// Whether a suspect counts in full.
  [[nodiscard]] bool is_in(Index number) const { return smoother_.weight(id(number)) == 1.0; }

 private:
  static constexpr double decisive_mu = 1e6;

  struct Entry {
    FactorId id;
    Suspect factor;
    double threshold, outlier_weight;
    Index leader;
    std::vector<Index> members;  ///< of a leader: its group, itself first
    double ratio;                ///< squared whitened residual at the estimate over the threshold
    bool trusted;
  };
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
    Entry& of = entry(number);
    const Suspect& f = of.factor;
    of.id =
        f.from == none ? smoother_.add(PriorFactor<Group>{f.to, f.measurement, f.sqrt_information}) : smoother_.add(f);
    if (!in) smoother_.set_weight(of.id, of.outlier_weight);
  }

  /// Puts what waits into the smoother: as outliers what the graph does not expect.
  void forecast() {
    for (const Index number : waiting_)
      entry(number).ratio = smoother_.what_if(entry(number).factor).rise / entry(number).threshold;
    for (const Index number : waiting_) {
      const Index leader = entry(number).leader;
      const bool in = weight_of(entry(number), group_ratio(entry(leader)), decisive_mu) == 1.0;
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
    std::erase_if(unexpected_, [&](Index leader) { return is_in(leader); });
    if (unexpected_.size() > options_.memory)
      unexpected_.erase(unexpected_.begin(), unexpected_.end() - static_cast<std::ptrdiff_t>(options_.memory));
    const std::size_t news = std::min(std::exchange(news_, 0), unexpected_.size());
    std::vector<Index> back = std::exchange(vouched_for_, {});
    for (const Index newest : std::span(unexpected_).last(news)) {
      std::vector<Index> agreeing{newest};
      for (const Index other : unexpected_)
        if (other != newest && agree(entry(other), entry(newest))) agreeing.push_back(other);
      if (to_index(agreeing.size()) >= options_.support) back.insert(back.end(), agreeing.begin(), agreeing.end());
    }
    for (const Index leader : back)
      for (const Index number : entry(leader).members) smoother_.set_weight(id(number), 1.0);
    return !back.empty();
  }

  using Jacobian = typename Group::Jacobian;

  /// Of x_from^-1 x_to, as a right perturbation.
  [[nodiscard]] Jacobian relative_covariance(Key from, Key to, const Group& T_from_to) const {
    constexpr int dof = Group::dof;
    const std::array<Key, 2> keys{from, to};
    if (from == to) return Jacobian::Zero();
    const Eigen::MatrixXd joint = smoother_.covariance(keys);
    Eigen::Matrix<double, dof, 2 * dof> J;
    J << -T_from_to.inverse().adjoint(), Jacobian::Identity();
    return J * joint * J.transpose();
  }
  [[nodiscard]] static Jacobian noise(const Suspect& factor) {
    const Jacobian root = factor.sqrt_information.inverse();
    return root * root.transpose();
  }
  [[nodiscard]] static Jacobian carried(const Jacobian& covariance, const Group& T) {
    const Jacobian adjoint = T.adjoint();
    return adjoint * covariance * adjoint.transpose();
  }

  /// Whether two measurements agree, by the ways that the estimate knows between their ends: pairwise consistency
  /// (Mangelson et al. 2018).
  [[nodiscard]] bool agree(const Entry& a, const Entry& b) const {
    const Suspect &one = a.factor, &other = b.factor;
    if (one.to == other.to || one.from == none || other.from == none) return false;  // of one scan: no second opinion
    const Group T_to = smoother_[one.to].inverse() * smoother_[other.to];
    const Group T_from = smoother_[one.from].inverse() * smoother_[other.from];
    const auto error = ((T_from * other.measurement).inverse() * (one.measurement * T_to)).log();
    const Jacobian covariance = noise(other) + carried(noise(one), T_to.inverse()) +
                                relative_covariance(one.to, other.to, T_to) +
                                carried(relative_covariance(one.from, other.from, T_from), other.measurement.inverse());
    const Jacobian seen = other.sqrt_information * covariance * other.sqrt_information.transpose();
    if (!(seen.trace() <= Group::dof * options_.max_blur * options_.max_blur)) return false;  // anything would agree
    return error.dot(covariance.llt().solve(error)) <= std::min(a.threshold, b.threshold);
  }

  [[nodiscard]] const Entry& entry(Index number) const { return suspects_[static_cast<std::size_t>(number)]; }
  [[nodiscard]] Entry& entry(Index number) { return suspects_[static_cast<std::size_t>(number)]; }

  void drop_last() {
    Entry& last = suspects_.back();
    of_key_[last.factor.to].pop_back();
    if (last.factor.from != none) of_key_[last.factor.from].pop_back();
    entry(last.leader).members.pop_back();
    suspects_.pop_back();
  }

  [[nodiscard]] bool step(IncrementalGncReport& report) {
    report.last = smoother_.update();
    ++report.steps;
    if (!report.last.ok()) return false;
    for (const Key key : smoother_.changed()) {
      changed_.push_back(key);
      const auto found = of_key_.find(key);
      if (found == of_key_.end()) continue;
      for (const Index number : found->second) measure(number);
    }
    return true;
  }

  /// A suspect that was removed from the smoother is never contradicted.
  void measure(Index number) {
    Entry& of = entry(number);
    const Suspect& factor = of.factor;
    of.ratio = 0.0;
    if (!smoother_.contains(of.id)) return;
    const Group T_from_to =
        factor.from == none ? smoother_[factor.to] : smoother_[factor.from].inverse() * smoother_[factor.to];
    of.ratio =
        (factor.sqrt_information * (factor.measurement.inverse() * T_from_to).log()).squaredNorm() / of.threshold;
    watched_.push_back(of.leader);
  }

  /// Members of a group share their information: m of them, half of it common, know as much as 2 m / (m + 1) alone.
  [[nodiscard]] static double votes(const Entry& leader) {
    return 0.5 * static_cast<double>(leader.members.size() + 1);
  }

  /// What half of a group does not exceed.
  [[nodiscard]] double group_ratio(const Entry& leader) {
    if (leader.members.size() == 1) return leader.ratio;
    ratios_.clear();
    for (const Index number : leader.members) ratios_.push_back(entry(number).ratio);
    const auto middle = ratios_.begin() + static_cast<std::ptrdiff_t>((ratios_.size() - 1) / 2);
    std::nth_element(ratios_.begin(), middle, ratios_.end());
    return votes(leader) * *middle;
  }

  /// Whether a suspect that was measured has not the weight that its residual asks for.
  [[nodiscard]] bool contradicted() {
    std::sort(watched_.begin(), watched_.end());
    watched_.erase(std::unique(watched_.begin(), watched_.end()), watched_.end());
    const bool found = std::any_of(watched_.begin(), watched_.end(), [&](Index number) {
      const Entry& leader = entry(number);
      const double of_group = group_ratio(leader);
      return std::any_of(leader.members.begin(), leader.members.end(), [&](Index member) {
        const Entry& one = entry(member);
        return is_judged(one) && smoother_.weight(one.id) != weight_of(one, of_group, decisive_mu);
      });
    });
    if (!found) watched_.clear();
    return found;
  }

  /// @param mu  the control parameter; `decisive_mu`: in or out
  [[nodiscard]] double weight_of(const Entry& one, double of_group, double mu) {
    const double ratio = std::max(votes(entry(one.leader)) * one.ratio, of_group);
    const double weight = mu < decisive_mu ? detail::truncated_weight(ratio, 1.0, mu) : (ratio <= 1.0 ? 1.0 : 0.0);
    return std::max(weight, one.outlier_weight);
  }

  [[nodiscard]] double first_mu() {
    double largest = 1.0;
    for (const Index leader : watched_)
      for (const Index number : entry(leader).members)
        if (is_weighed(number)) largest = std::max(largest, votes(entry(leader)) * entry(number).ratio);
    return 1.0 / (2.0 * largest - 1.0);
  }
  [[nodiscard]] bool is_weighed(Index number) {
    const Entry& one = entry(number);
    return is_judged(one) && smoother_.weight(one.id) > one.outlier_weight;
  }

  void weigh(Index leader, double mu) {
    const double of_group = group_ratio(entry(leader));
    for (const Index number : entry(leader).members) {
      const Entry& of = entry(number);
      if (!is_judged(of)) continue;
      const double next = weight_of(of, of_group, mu);
      if (std::abs(next - smoother_.weight(of.id)) > 1e-3 || next == of.outlier_weight || next == 1.0)
        smoother_.set_weight(of.id, next);
    }
  }

  Smoother& smoother_;
  IncrementalGncOptions options_;
  std::vector<Entry> suspects_;
  std::unordered_map<Key, std::vector<Index>> of_key_;
  std::vector<Index> watched_;  ///< leaders of groups measured since there was last no contradiction
  std::vector<Key> changed_;
  std::vector<double> ratios_;      ///< room for one group's
  std::vector<Index> waiting_;      ///< to be put into the smoother by the next update
  std::vector<Index> unexpected_;   ///< leaders of groups
  std::size_t news_ = 0;            ///< how many of these are new
  std::vector<Index> vouched_for_;  ///< leaders
  bool trusting_ = true;
  Index settled_ = 0;  ///< suspects that have taken part in an update
};

}  // namespace chainslam
