#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <unordered_map>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/between_factor.hpp"
#include "chainslam/factor_graph/graduated_non_convexity.hpp"
#include "chainslam/factor_graph/incremental_smoother.hpp"

namespace chainslam {

struct IncrementalGncOptions {
  /// Squared whitened residual beyond which a factor is an outlier. 0: what one good factor in a hundred exceeds.
  double threshold = 0.0;
  double growth = 2.0;  ///< of the control parameter, a step
  Index max_steps = 40;
};

struct IncrementalGncReport {
  UpdateReport last;    ///< of the last update
  Index steps = 0;      ///< updates
  bool decided = true;  ///< whether each suspect is in or out, as its residual says; else the steps did not suffice
};

/// Takes suspects into a growing graph, and decides again which of them lie whenever they contradict each other or the
/// rest: graduated non-convexity with truncated least squares (Yang et al. 2020) where the contradiction is, each step
/// an update of the smoother (McGann, Rogers and Kaess 2023, "riSAM", where the steps are those of a scale-invariant
/// kernel).
///
/// A suspect counts in full until it is contradicted. Suspects that are out count again when the estimate comes to
/// agree with them. Where nothing contradicts, an update costs what the smoother's does. Factors beyond suspicion,
/// which are given to the smoother itself, must hold the graph together.
template <class Smoother>
class IncrementalGnc {
 public:
  using Group = typename Smoother::Value;
  using Suspect = BetweenFactor<Group>;

  /// @param smoother  stays the caller's, and outlives this.
  explicit IncrementalGnc(Smoother& smoother, const IncrementalGncOptions& options = {})
      : smoother_(smoother), options_(options) {
    if (!(options_.threshold > 0.0)) options_.threshold = chi_squared_99(Group::dof);
  }

  /// Adds a suspect to the smoother.
  FactorId add(const Suspect& suspect) {
    const FactorId id = smoother_.add(suspect);
    const Index number = to_index(suspects_.size());
    suspects_.push_back({id, suspect, 0.0});
    for (const Key key : suspect.keys()) of_key_[key].push_back(number);
    fresh_.push_back(number);
    return id;
  }

  /// Updates the smoother until each suspect is in or out. If the first update fails, the suspects added since the last
  /// are gone, as all else; if a later one does, the decision waits for the next time.
  IncrementalGncReport update() {
    IncrementalGncReport report;
    if (!step(report)) {
      while (!fresh_.empty()) drop_last();
      return report;
    }
    for (const Index number : fresh_) measure(number);
    fresh_.clear();
    double mu = 0.0;
    while (contradicted()) {
      report.decided = report.steps < options_.max_steps;
      mu = mu > 0.0 ? options_.growth * mu : first_mu();
      for (const Index number : watched_) weigh(number, report.decided ? mu : decisive_mu);
      if (!step(report) || !report.decided) break;
    }
    return report;
  }

  /// How much a suspect counts: 1 in, 0 out.
  [[nodiscard]] double weight(const FactorId& id) const { return smoother_.weight(id); }

 private:
  static constexpr double decisive_mu = 1e6;

  struct Entry {
    FactorId id;
    Suspect factor;
    double squared;  ///< whitened residual at the estimate
  };

  [[nodiscard]] Entry& entry(Index number) { return suspects_[static_cast<std::size_t>(number)]; }

  void drop_last() {
    for (const Key key : suspects_.back().factor.keys()) of_key_[key].pop_back();
    suspects_.pop_back();
    fresh_.pop_back();
  }

  [[nodiscard]] bool step(IncrementalGncReport& report) {
    report.last = smoother_.update();
    ++report.steps;
    if (!report.last.ok()) return false;
    for (const Key key : smoother_.changed()) {
      const auto found = of_key_.find(key);
      if (found == of_key_.end()) continue;
      for (const Index number : found->second) measure(number);
    }
    return true;
  }

  /// A suspect that was removed from the smoother is never contradicted.
  void measure(Index number) {
    Entry& of = entry(number);
    if (!smoother_.contains(of.id)) {
      of.squared = 0.0;
      return;
    }
    Values<Group> ends;
    Suspect alone = of.factor;
    alone.from = ends.add(smoother_[of.factor.from]);
    alone.to = ends.add(smoother_[of.factor.to]);
    of.squared = alone.residual(ends).squaredNorm();
    watched_.push_back(number);
  }

  /// Whether a suspect that was measured has not the weight that its residual asks for.
  [[nodiscard]] bool contradicted() {
    std::sort(watched_.begin(), watched_.end());
    watched_.erase(std::unique(watched_.begin(), watched_.end()), watched_.end());
    std::erase_if(watched_, [&](Index number) { return !smoother_.contains(entry(number).id); });
    const bool found = std::any_of(watched_.begin(), watched_.end(), [&](Index number) {
      return weight(entry(number).id) != (entry(number).squared <= options_.threshold ? 1.0 : 0.0);
    });
    if (!found) watched_.clear();
    return found;
  }

  [[nodiscard]] double first_mu() {
    double largest = options_.threshold;
    for (const Index number : watched_) {
      if (weight(entry(number).id) > 0.0) largest = std::max(largest, entry(number).squared);
    }
    return options_.threshold / (2.0 * largest - options_.threshold);
  }

  void weigh(Index number, double mu) {
    const Entry& of = entry(number);
    const double next = detail::truncated_weight(of.squared, options_.threshold, mu);
    if (std::abs(next - weight(of.id)) > 1e-3 || next == 0.0 || next == 1.0) smoother_.set_weight(of.id, next);
  }

  Smoother& smoother_;
  IncrementalGncOptions options_;
  std::vector<Entry> suspects_;
  std::unordered_map<Key, std::vector<Index>> of_key_;
  std::vector<Index> fresh_;    ///< added since the last update
  std::vector<Index> watched_;  ///< measured since there was last no contradiction
};

}  // namespace chainslam
