#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/incremental_gnc.hpp"
#include "chainslam/factor_graph/incremental_smoother.hpp"
#include "chainslam/slam/detail/graph_factors.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam {

/// Decides which closures, GNSS fixes and steps of odometry are outliers, and decides again whenever something speaks
/// against it: see `IncrementalGnc`. A closure that the graph does not expect is left out until enough others agree
/// with it, or the fixes do; then odometry itself may be found to be wrong. So may it be where a drive ends and its
/// fixes go another way. In the end all steps between two keyframes with closures share an error that is found, since
/// nothing says which of them failed. A chained closure is in the group of the closure that led to it: together they
/// have one vote.
///
/// Thresholds are squared Mahalanobis distances, set on three real drives of NCLT (`IncrementalGncOptions`).
struct GroupGnc {
  double closures = 40.0;        ///< squared whitened residual beyond which a closure is an outlier; 0: none is
  double odometry = 70.0;        ///< the same of a step of odometry; consecutive ones cost a tenth each; 0: none is
  double outlier_weight = 1e-8;  ///< what an outlier still counts, so that no session ever comes loose
};

/// A map's factors, and which of them count.
class GroupGncFactors {
 public:
  using Smoother = IncrementalSmoother<SE3d>;  ///< the smoother behind
  using ClosureFactor = BetweenFactor<SE3d>;   ///< the factor of a closure

  /// An empty graph.
  template <class Options>
  [[gnu::cold]] GroupGncFactors(const Options& options, const GroupGnc& gnc)
      : options_(gnc),
        smoother_(options.smoother, NoLag{}),
        gnc_(smoother_),
        gnss_(options.gnss),
        gravity_(options.gravity) {}
  GroupGncFactors(const GroupGncFactors&) = delete;
  GroupGncFactors& operator=(const GroupGncFactors&) = delete;

  [[nodiscard]] Smoother& smoother() { return smoother_; }              ///< the smoother behind
  [[nodiscard]] const Smoother& smoother() const { return smoother_; }  ///< the smoother behind

  /// Adds a factor.
  void add(const OdometryMeasurement& step) {
    const ClosureFactor factor{step.from.value, step.to.value, step.T_from_to, step.sqrt_information};
    if (!(options_.odometry > 0)) {
      smoother_.add(factor);
      return;
    }
    constexpr double judged = 0.4;  // what may have failed is looked for more freely than it is believed
    const bool goes_on = last_step_ != Gnc::none && gnc_.factor(last_step_).to == factor.from;
    last_step_ = gnc_.add(factor, {.threshold = judged * options_.odometry,
                                   .price = options_.odometry,
                                   .outlier_weight = options_.outlier_weight,
                                   .trusted = true,
                                   .previous = goes_on ? last_step_ : Gnc::none});
    if (factor.to >= steps_.size()) steps_.resize(factor.to + 1, Gnc::none);
    steps_[factor.to] = last_step_;
  }

  /// Adds the closure at a position among the map's; they come in their order. What was an outlier begins as one.
  [[gnu::cold]] void add_closure(const SlamMap& map, Index position) {
    const LoopClosure& closure = map.closures[static_cast<std::size_t>(position)];
    candidates_.push_back(Gnc::none);
    if (!closure.is_factor()) return;
    const ClosureFactor factor{closure.from.value, closure.to.value, closure.T_from_to, closure.sqrt_information};
    if (!(options_.closures > 0)) {
      smoother_.add(factor);
      return;
    }
    const bool follows = closure.kind == ClosureKind::chained && closure.cause >= 0;
    const OutlierTest test{.threshold = options_.closures,
                           .outlier_weight = options_.outlier_weight,
                           .begins_in = closure.verdict == ClosureVerdict::accepted,
                           .forecast = closure.kind != ClosureKind::merge};  // which several places have confirmed
    const Index number = gnc_.add(factor, test, follows ? candidates_[closure.cause] : Gnc::none);
    candidates_[position] = number;
    closures_.resize(number + 1, Gnc::none);
    closures_[number] = position;
  }

  /// The keyframe's fix, if it has one, is taken in by the next update.
  void wait(const Keyframe& keyframe) {
    gnss_.wait(keyframe);
    gravity_.wait(keyframe.id);
  }
  /// The keyframe has got a fix later.
  void wait_for_fix(const Keyframe& keyframe) { gnss_.wait(keyframe); }
  [[nodiscard]] Index waiting() const { return gnss_.waiting(); }  ///< fixes that wait for a factor
  /// Keyframes go over to another frame.
  void carry(std::span<const Key> keyframes) {
    gnss_.carry(keyframes, gnc_);
    gravity_.carry(keyframes, gnc_);
  }
  /// Takes in what the accelerometer says of the keyframes' attitudes.
  /// @returns sessions whose frames gravity holds upright from now on: their priors must let them lean.
  [[nodiscard]] std::vector<SessionId> hold_upright(const SlamMap& map) { return gravity_.add(map, gnc_); }

  /// Takes in closures that wait for a forecast, without one. @returns whether there were any.
  [[nodiscard]] bool admit() { return gnc_.admit(); }

  /// Takes in what was added and makes the estimate better.
  /// @returns what the last update says, and the work of all.
  [[nodiscard]] [[gnu::cold]] UpdateReport update(const SlamMap& map) {
    gnss_.add(map, gnc_);
    if (!map.sessions.empty()) lower_prices(map, map.sessions.back());
    ask_fixes(map);
    IncrementalGncReport report = gnc_.update();
    report.last.work = report.work;
    return std::move(report.last);
  }
  /// Keys whose estimate the last update changed.
  [[nodiscard]] std::span<const Key> changed() const { return gnc_.changed(); }

  /// To the optimum, and until what counts there does not change it any more.
  template <class Options, Executor E>
  [[nodiscard]] [[gnu::cold]] ConvergeReport converge(const Options& options, SlamMap& map, const E& executor) {
    constexpr int passes = 3;  // each says more exactly where the map lies on the Earth
    constexpr int decisions = 4;
    constexpr double rounding = 1e-9;  // of the cost
    ConvergeReport report;
    double before = smoother_.current_cost();
    for (int pass = 0; pass < passes; ++pass) {
      gnss_.renew();
      for (const Session& session : map.sessions) lower_prices(map, session);
      if (!update(map).ok()) break;
      bool decided = false;
      for (int decision = 0; decision < decisions; ++decision) {
        report = smoother_.converge(options, executor);
        if (!report.ok()) return report;
        for (Key key = 0; key < smoother_.size(); ++key)
          map.keyframes[static_cast<std::size_t>(key)].T_map_body = smoother_[key];
        if (decision + 1 == decisions || gnc_.reconsider(executor).steps == 0) break;
        decided = true;
      }
      if (!decided && std::abs(report.final_cost - before) <= rounding * before) break;
      before = report.final_cost;
    }
    if (report.ok() && gnc_.share_errors()) report = smoother_.converge(options, executor);
    return report;
  }

  /// Writes what was decided into the closures' verdicts.
  /// @returns whether an accepted closure is an outlier now.
  [[nodiscard]] [[gnu::cold]] bool record(SlamMap& map) {
    bool lost = false;
    for (const Index number : gnc_.take_weighed()) {
      const Index closure = number < closures_.size() ? closures_[number] : Gnc::none;
      if (closure == Gnc::none) continue;
      ClosureVerdict& verdict = map.closures[static_cast<std::size_t>(closure)].verdict;
      const bool in = gnc_.is_in(number);
      lost |= !in && verdict == ClosureVerdict::accepted;
      verdict = in ? ClosureVerdict::accepted : ClosureVerdict::inconsistent;
    }
    return lost;
  }

 private:
  using Gnc = IncrementalGnc<Smoother>;

  /// Vouches for unexpected closures of the newest session where the fixes say that odometry, not they, is wrong.
  [[gnu::cold]] void ask_fixes(const SlamMap& map) {
    constexpr std::size_t asked = 10;
    const std::span<const Index> unexpected = gnc_.unexpected();
    for (const Index one : unexpected.last(std::min(asked, unexpected.size()))) {
      const ClosureFactor& closure = gnc_.factor(one);
      if (closure.to < map.sessions.back().first_keyframe) continue;
      const auto pose = [&](Key key) { return map.keyframes[static_cast<std::size_t>(key)].T_map_body; };
      const SE3d T_new_old = pose(closure.from) * closure.measurement * pose(closure.to).inverse();
      if (gnss_.gain(map, T_new_old, closure.to, gnc_) > options_.odometry) gnc_.vouch_for(one);
    }
  }

  /// Lowers the price of the step of odometry that a session's last fixes speak against most, and raises it again where
  /// they do not any more.
  [[gnu::cold]] void lower_prices(const SlamMap& map, const Session& session) {
    constexpr double by_chance = 20;  // squared deviations that the best of so many steps may gain
    if (!(options_.odometry > 0)) return;
    const auto pose = [&](Key key) { return map.keyframes[static_cast<std::size_t>(key)].T_map_body; };
    const auto step = [&](Index k) { return k < steps_.size() ? steps_[k] : Gnc::none; };
    const auto join = [&](Index k) {
      if (step(k) == Gnc::none) return SE3d();
      const ClosureFactor& odometry = gnc_.factor(step(k));
      return pose(odometry.from) * odometry.measurement * pose(k).inverse();
    };
    Ranked most{by_chance, Gnc::none};
    gnss_.for_each_failed_step(map, session, join, [&](Index k, double evidence) {
      if (step(k) == Gnc::none) return;
      if (gnc_.has_lower_price(step(k))) gnc_.lower_price(step(k), evidence);
      if (evidence > most.rank) most = {evidence, step(k)};
    });
    if (most.index != Gnc::none) gnc_.lower_price(most.index, most.rank);
  }

  GroupGnc options_;
  Smoother smoother_;
  Gnc gnc_;
  detail::GnssFactors<Gnc> gnss_;
  detail::GravityFactors<Gnc> gravity_;
  Index last_step_ = Gnc::none;      ///< of odometry, its number in `gnc_`
  detail::Table<Index> steps_;       ///< of each keyframe the number of the step that leads to it, or none
  detail::Table<Index> candidates_;  ///< of each closure its number in `gnc_`, none if it is never judged
  detail::Table<Index> closures_;    ///< of each number in `gnc_` the closure's position, none if it is another factor
};

}  // namespace chainslam
