#pragma once

#include <optional>
#include <utility>

#include "chainslam/factor_graph/chordal_initialization.hpp"
#include "chainslam/factor_graph/constrained_factor.hpp"
#include "chainslam/factor_graph/detail/damped_descent.hpp"
#include "chainslam/factor_graph/incremental_smoother.hpp"

// How `IncrementalSmoother` goes on to an optimum.

namespace chainslam {

namespace detail {

/// While it lives, fronts keep nothing for their parents: `converge` computes all of them again in each step.
template <class Solver>
class UpdatesNotKept {
 public:
  explicit UpdatesNotKept(Solver& solver) : solver_(solver) { solver_.keep_updates(false); }
  UpdatesNotKept(const UpdatesNotKept&) = delete;
  UpdatesNotKept& operator=(const UpdatesNotKept&) = delete;
  ~UpdatesNotKept() { solver_.keep_updates(true); }

 private:
  Solver& solver_;
};

/// Whether `converge` may start again from the chordal relaxation, which only rigid motions have.
template <class Group, class Restart>
inline constexpr bool restarts = false;
template <RigidMotionGroup Group>
inline constexpr bool restarts<Group, ChordalRestart> = true;

}  // namespace detail

/// The smoother's graph with values of its own, as the chordal relaxation asks for one.
template <class Group, class... Extra>
class IncrementalSmoother<Group, Extra...>::View {
 public:
  using Value = Group;

  View(const IncrementalSmoother& smoother, Values<Group> values) : smoother_(smoother), values_(std::move(values)) {}

  [[nodiscard]] const Values<Group>& values() const { return values_; }
  [[nodiscard]] bool is_fixed(Key key) const { return smoother_.is_fixed(key); }
  template <class Visit>
  void for_each_factor(Visit&& visit) const {
    smoother_.for_each_factor(visit);
  }

 private:
  const IncrementalSmoother& smoother_;
  Values<Group> values_;
};

template <class Group, class... Extra>
template <class Restart, Executor Exec>
ConvergeReport IncrementalSmoother<Group, Extra...>::converge(const ConvergeOptions<Restart>& options,
                                                              const Exec& executor) {
  const detail::UpdatesNotKept memory(solver_);
  ConvergeReport report = converge_penalized(options, executor);
  if constexpr (any_constraint) {
    report.violation = violation();
    for (detail::ConstraintRounds rounds; report.ok() && rounds.more(report.violation);) {
      tighten();
      ConvergeReport next = converge_penalized(options, executor);
      next.initial_cost = report.initial_cost;
      next.iterations += report.iterations;
      next.violation = violation();
      report = std::move(next);
    }
  }
  return report;
}

template <class Group, class... Extra>
double IncrementalSmoother<Group, Extra...>::violation() const {
  double worst = 0.0;
  pools_.for_each([&](const auto& entry) {
    if constexpr (detail::is_constraint<std::remove_cvref_t<decltype(entry.factor)>>)
      worst = std::max(worst, entry.factor.violation(estimates_));
  });
  return worst;
}

/// The next update takes it in if it relinearizes everything.
template <class Group, class... Extra>
void IncrementalSmoother<Group, Extra...>::tighten() {
  begin();
  costs_.outdate();
  pools_.for_each([&](const auto& entry) {
    using F = std::remove_cvref_t<decltype(entry.factor)>;
    if constexpr (detail::is_constraint<F>) {
      changes_.push_back({ChangeKind::factor_tightened, entry.term, static_cast<double>(multipliers_before_.size())});
      const auto& before = entry.factor.multipliers;
      multipliers_before_.append({before.data(), static_cast<std::size_t>(before.size())});
      pools_.template pool<F>().factor(pools_.place(entry.term).slot).tighten(estimates_);
    }
  });
}

template <class Group, class... Extra>
void IncrementalSmoother<Group, Extra...>::restore_multipliers(const Change& change) {
  const auto place = pools_.place(change.id);
  Index type = 0;
  pools_.for_each_pool([&](auto& pool) {
    using F = typename std::remove_cvref_t<decltype(pool)>::Type;
    if constexpr (detail::is_constraint<F>) {
      if (type == place.type)
        pool.factor(place.slot)
            .set_multipliers(
                Eigen::Map<const typename F::Residual>(multipliers_before_.data() + static_cast<Offset>(change.look)));
    }
    ++type;
  });
}

template <class Group, class... Extra>
template <class Restart, Executor Exec>
ConvergeReport IncrementalSmoother<Group, Extra...>::converge_penalized(const ConvergeOptions<Restart>& options,
                                                                        const Exec& executor) {
  constexpr double rounding = 1e-12;  // of a sum of squares
  ConvergeReport report;
  report.initial_cost = report.final_cost = cost();
  Values<Group> best = values();
  for (;;) {
    relinearize_all();
    UpdateReport step = update_to(true, executor);
    report.status = step.status;
    report.variables = std::move(step.variables);
    report.free = std::move(step.free);
    if (!step.ok()) return report;
    ++report.iterations;
    report.gap = solver_.lowered();
    const double now = cost();
    const double tolerance = options.relative_tolerance * report.final_cost + options.absolute_tolerance;
    if (!(now <= report.final_cost + tolerance + rounding * report.final_cost)) {
      damped_descent(std::move(best), options, report, executor);
      return report;
    }
    report.final_cost = now;
    report.converged = report.gap <= tolerance;
    if (report.converged || report.iterations >= options.max_iterations) break;
    best = values();
  }
  Index rows = 0;
  for (const Index term : pools_.terms()) rows += solver_.terms().rows(term);
  if (detail::restarts<Group, Restart> && report.final_cost > 2.0 * std::max(0, rows - size() * dof))
    damped_descent(values(), options, report, executor);
  return report;
}

/// Levenberg and Marquardt from `start`, and from the chordal relaxation if asked for; the lower optimum becomes the
/// estimate.
template <class Group, class... Extra>
template <class Restart, Executor Exec>
void IncrementalSmoother<Group, Extra...>::damped_descent(Values<Group> start, const ConvergeOptions<Restart>& options,
                                                          ConvergeReport& report, const Exec& executor) {
  const LevenbergMarquardt method{.max_iterations = 4 * options.max_iterations,
                                  .relative_tolerance = options.relative_tolerance,
                                  .absolute_tolerance = options.absolute_tolerance};
  detail::DampedDescent<Group, Pools> descent(pools_, solver_);
  const auto descend = [&](const Values<Group>& from, ConvergeMethod name, double share) {
    Values<Group> lowest = from;
    const OptimizeReport result = descent.run(method, lowest, executor);
    report.iterations += result.iterations;
    if (!result.ok() || !(result.final_cost <= share * report.final_cost)) return;
    report.final_cost = result.final_cost;
    report.method = name;
    report.converged = result.status == OptimizeStatus::converged;
    start = std::move(lowest);
  };
  if (!report.converged) descend(start, ConvergeMethod::levenberg_marquardt, 1.0);
  if constexpr (detail::restarts<Group, Restart>) {
    const std::optional<Values<Group>> relaxed = chordal_initialization(View(*this, start));
    if (relaxed) descend(*relaxed, ConvergeMethod::chordal_restart, 1.0 - 1e-9);
  }
  for (int round = 0; round < 3; ++round) {
    begin();
    for (Key key = 0; key < size(); ++key) {
      if (!solver_.is_fixed(key)) relinearize_at(key, start[key]);
    }
    UpdateReport step = update_to(true, executor);
    report.status = step.status;
    report.variables = std::move(step.variables);
    report.gap = solver_.lowered();
    const double now = cost();
    if (!step.ok() || now <= (1.0 + 1e-12) * report.final_cost + options.absolute_tolerance) {
      report.final_cost = now;
      return;
    }
    descend(start, ConvergeMethod::levenberg_marquardt, 1.0);  // where the iterations did not suffice
  }
}

template <class Group, class... Extra>
void IncrementalSmoother<Group, Extra...>::relinearize_all() {
  begin();
  for (Key key = 0; key < size(); ++key) {
    if (!solver_.is_fixed(key)) relinearize_at_estimate(key);
  }
}

}  // namespace chainslam
