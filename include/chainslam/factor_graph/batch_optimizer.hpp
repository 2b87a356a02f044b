#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <span>
#include <vector>

#include "chainslam/core/compiled.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/constrained_factor.hpp"
#include "chainslam/factor_graph/detail/held_components.hpp"
#include "chainslam/factor_graph/detail/normal_equations.hpp"
#include "chainslam/factor_graph/detail/open_directions.hpp"
#include "chainslam/factor_graph/detail/springed_system.hpp"
#include "chainslam/factor_graph/factor_graph.hpp"
#include "chainslam/factor_graph/free_part.hpp"
#include "chainslam/factor_graph/values.hpp"
#include "chainslam/sparse/cholesky.hpp"
#include "chainslam/sparse/concepts.hpp"

namespace chainslam {

enum class OptimizeStatus {
  converged,        ///< the next step would lower the cost by less than the tolerance
  iteration_limit,  ///< values are better than before, but not yet converged
  stalled,          ///< no step lowers the cost any more, though one was predicted to; values are the best ones found
  unconstrained,    ///< parts of the graph hang on no prior and no fixed variable; `variables` has each one's least key
  singular,         ///< a direction of variable `variables[0]` is not measured, given those eliminated before it
  diverged,         ///< the cost rose above the initial one
  not_finite,       ///< the cost is not a number: check values and measurements
};

/// What `optimize` did. Costs are sums of squared whitened residuals (chi^2), through the kernels.
struct OptimizeReport {
  OptimizeStatus status = OptimizeStatus::converged;  ///< how it ended
  Index iterations = 0;                               ///< linear systems solved
  double initial_cost = 0.0;                          ///< of the values as they were
  double final_cost = 0.0;                            ///< of the graph's values as they are left
  double violation = 0.0;      ///< how far the worst row of `Constrained` factors is from zero there, in its own units
  std::vector<Key> variables;  ///< keys that a failure concerns
  /// Where something is unconstrained or singular: what is free to move, and how; `describe` says it in words.
  std::vector<FreePart> free;

  /// Whether the graph took the new values. If not, it has its old ones.
  [[nodiscard]] bool ok() const {
    return status == OptimizeStatus::converged || status == OptimizeStatus::iteration_limit ||
           status == OptimizeStatus::stalled;
  }
};

/// Steps damped by how well the linearization predicted the last one: the cost never rises.
///
/// The damping is `lambda` times the diagonal of J^T J (Marquardt 1963), driven by the gain ratio (Nielsen 1999;
/// Madsen, Nielsen and Tingleff 2004, section 3.2).
struct LevenbergMarquardt {
  Index max_iterations = 100;        ///< linear systems solved, at most
  double relative_tolerance = 1e-9;  ///< as in `GaussNewton`
  double absolute_tolerance = 1e-9;  ///< as in `GaussNewton`
  double initial_lambda = 1e-6;      ///< damping of the first step
  double max_lambda = 1e12;          ///< beyond it, the optimization has stalled
};

/// Full steps to the minimum of the linearized cost: the fastest near the optimum.
struct GaussNewton {
  Index max_iterations = 20;  ///< linear systems solved, at most
  /// Converged when a step is predicted to lower the cost by less than this share of it,
  double relative_tolerance = 1e-9;
  /// or by less than this.
  double absolute_tolerance = 1e-9;
};

/// Steps within a region in which the linearization has proven good, from steepest descent to full steps (Powell 1970;
/// Madsen, Nielsen and Tingleff 2004, section 3.3): the cost never rises, and a step that is refused costs no
/// factorization. Lengths are scaled by the diagonal of J^T J.
struct Dogleg {
  Index max_iterations = 100;                                       ///< linear systems solved, at most
  double relative_tolerance = 1e-9;                                 ///< as in `GaussNewton`
  double absolute_tolerance = 1e-9;                                 ///< as in `GaussNewton`
  double initial_radius = std::numeric_limits<double>::infinity();  ///< the first step tried is then a full one
};

namespace detail {

/// One optimization's state and memory.
template <class Graph, class Solver>
class BatchOptimization {
 public:
  using Group = typename Graph::Value;

  BatchOptimization(const Graph& graph, Solver& solver)
      : graph_(graph), solver_(solver), equations_(graph), values_(graph.values()), candidate_(graph.values()) {
    step_.resize(equations_.gradient().size());
    damping_.resize(static_cast<std::size_t>(step_.size()));
    diagonal_.resize(damping_.size());
    solver_.analyze(equations_.matrix().pattern());
  }

  [[nodiscard]] OptimizeReport run(const GaussNewton& method) {
    OptimizeReport report = begin();
    double cost = report.initial_cost;
    while (std::isfinite(cost)) {
      if (!solve({}, report)) return report;
      equations_.retract(step_, values_, values_);
      const double predicted = downhill();
      const bool converged = predicted <= tolerance(method, cost);
      if (converged || report.iterations >= method.max_iterations) {
        report.status = converged ? OptimizeStatus::converged : OptimizeStatus::iteration_limit;
        return finish(graph_.cost(values_), method, report);
      }
      cost = equations_.linearize(graph_, values_);
    }
    return finish(cost, method, report);
  }

  [[nodiscard]] OptimizeReport run(const LevenbergMarquardt& method) {
    OptimizeReport report = begin();
    double cost = report.initial_cost;
    double lambda = method.initial_lambda;
    double growth = 2.0;
    equations_.diagonal(diagonal_);
    while (std::isfinite(cost)) {
      std::transform(diagonal_.begin(), diagonal_.end(), damping_.begin(),
                     [&](double entry) { return lambda * entry; });
      if (!solve(damping_, report)) return report;
      const double predicted = downhill() + damped_square();
      equations_.retract(step_, values_, candidate_);
      const double next = graph_.cost(candidate_);
      const bool accepted = next <= cost;
      if (accepted) std::swap(values_, candidate_);
      // A strongly damped step promises little wherever it stands: it says nothing about the optimum.
      const bool converged = predicted <= tolerance(method, cost) && lambda <= 1e-2;
      if (converged || report.iterations >= method.max_iterations || lambda > method.max_lambda) {
        report.status = converged                    ? OptimizeStatus::converged
                        : lambda > method.max_lambda ? OptimizeStatus::stalled
                                                     : OptimizeStatus::iteration_limit;
        return finish(accepted ? next : cost, method, report);
      }
      if (accepted) {
        const double gain = (cost - next) / predicted;
        lambda *= std::max(1.0 / 3.0, 1.0 - std::pow(2.0 * gain - 1.0, 3));
        growth = 2.0;
        cost = equations_.linearize(graph_, values_);
        equations_.diagonal(diagonal_);
      } else {
        lambda *= growth;
        growth *= 2.0;
      }
    }
    return finish(cost, method, report);
  }

  [[nodiscard]] OptimizeReport run(const Dogleg& method) {
    OptimizeReport report = begin();
    double cost = report.initial_cost;
    double radius = method.initial_radius;
    while (std::isfinite(cost)) {
      if (!solve({}, report)) return report;
      const Eigen::VectorXd newton = step_;
      const bool converged = downhill() <= tolerance(method, cost);
      const double next = step_within(newton, radius, cost);
      const bool stalled = !(next <= cost);
      if (!stalled) std::swap(values_, candidate_);
      if (converged || stalled || report.iterations >= method.max_iterations) {
        report.status = converged ? OptimizeStatus::converged
                        : stalled ? OptimizeStatus::stalled
                                  : OptimizeStatus::iteration_limit;
        return finish(stalled ? cost : next, method, report);
      }
      cost = equations_.linearize(graph_, values_);
    }
    return finish(cost, method, report);
  }

  [[nodiscard]] Values<Group> take_values() { return std::move(values_); }

 private:
  /// Tries steps within the region, which shrinks until one does not raise the cost, and then grows if that was as
  /// good as predicted. The values it leads to are in `candidate_`.
  /// @returns the cost there; above `cost` if there is no such step.
  [[nodiscard]] double step_within(const Eigen::VectorXd& newton, double& radius, double cost) {
    equations_.diagonal(diagonal_);
    const Eigen::VectorXd& gradient = equations_.gradient();
    const Eigen::Map<const Eigen::VectorXd> scale(diagonal_.data(), gradient.size());
    const auto length = [&](const Eigen::VectorXd& step) { return std::sqrt(step.cwiseAbs2().dot(scale)); };
    Eigen::VectorXd cauchy = -gradient.cwiseQuotient(scale.cwiseMax(std::numeric_limits<double>::min()));
    const Eigen::VectorXd curved = equations_.matrix() * cauchy;
    cauchy *= -gradient.dot(cauchy) / cauchy.dot(curved);
    for (int refused = 0;; ++refused) {
      step_ = dogleg(newton, cauchy, radius, length);
      const Eigen::VectorXd product = equations_.matrix() * step_;
      const double predicted = -2.0 * gradient.dot(step_) - step_.dot(product);
      equations_.retract(step_, values_, candidate_);
      const double next = graph_.cost(candidate_);
      const double gain = (cost - next) / predicted;
      if (!(gain >= 0.25)) radius = 0.25 * length(step_);
      if (gain > 0.75) radius = std::max(radius, 3.0 * length(step_));
      if (next <= cost || refused == 40) return next;
    }
  }

  /// From the minimum along the gradient towards the full step, as far as the radius goes.
  template <class Length>
  [[nodiscard]] static Eigen::VectorXd dogleg(const Eigen::VectorXd& newton, const Eigen::VectorXd& cauchy,
                                              double radius, Length&& length) {
    if (length(newton) <= radius) return newton;
    const double first = length(cauchy);
    if (first >= radius) return cauchy * (radius / first);
    const Eigen::VectorXd leg = newton - cauchy;
    const double a = length(leg) * length(leg);
    const double whole = length(newton);
    const double b = 0.5 * (whole * whole - a - first * first);  // cauchy . leg
    const double c = radius * radius - first * first;
    return cauchy + leg * (c / (b + std::sqrt(b * b + a * c)));
  }

  [[nodiscard]] OptimizeReport begin() {
    OptimizeReport report;
    report.initial_cost = report.final_cost = equations_.linearize(graph_, values_);
    return report;
  }

  /// Solves for the next step; if that fails, the report says why.
  [[nodiscard]] bool solve(std::span<const double> damping, OptimizeReport& report) {
    ++report.iterations;
    const FactorizationResult result = solver_.factorize(equations_.matrix(), damping);
    if (!result.ok()) {
      report.status = OptimizeStatus::singular;
      report.variables = {equations_.key(result.block_column)};
      return false;
    }
    step_ = -equations_.gradient();
    solver_.solve({step_.data(), static_cast<std::size_t>(step_.size())});
    return true;
  }

  /// -gradient . step
  [[nodiscard]] double downhill() const {
    const Eigen::VectorXd& gradient = equations_.gradient();
    return -std::inner_product(step_.data(), step_.data() + step_.size(), gradient.data(), 0.0);
  }

  /// step . diag(damping) step
  [[nodiscard]] double damped_square() const {
    double sum = 0.0;
    for (Eigen::Index i = 0; i < step_.size(); ++i) sum += damping_[static_cast<std::size_t>(i)] * step_[i] * step_[i];
    return sum;
  }

  template <class Method>
  [[nodiscard]] static double tolerance(const Method& method, double cost) {
    return method.relative_tolerance * cost + method.absolute_tolerance;
  }

  template <class Method>
  [[nodiscard]] static OptimizeReport finish(double cost, const Method& method, OptimizeReport report) {
    if (!std::isfinite(cost)) {
      report.status = OptimizeStatus::not_finite;
    } else if (cost > report.initial_cost + tolerance(method, report.initial_cost)) {
      report.status = OptimizeStatus::diverged;
    } else {
      report.final_cost = cost;
    }
    return report;
  }

  const Graph& graph_;
  Solver& solver_;
  NormalEquations<Graph> equations_;
  Values<Group> values_;
  Values<Group> candidate_;
  Eigen::VectorXd step_;
  std::vector<double> damping_;
  std::vector<double> diagonal_;
};

/// Optimizes with constraints as penalties.
template <class Graph, class Method, class Solver>
[[nodiscard]] OptimizeReport optimize_springs(Graph& graph, const Method& method, Solver& solver) {
  auto components = components_of(graph);
  std::vector<Key> floating = components.floating();
  if (!floating.empty()) {
    OptimizeReport report;
    report.status = OptimizeStatus::unconstrained;
    report.initial_cost = report.final_cost = graph.cost();
    report.free = components.free_parts(floating, graph.values());
    report.variables = std::move(floating);
    return report;
  }
  BatchOptimization<Graph, Solver> optimization(graph, solver);
  OptimizeReport report = optimization.run(method);
  if (report.ok()) graph.set_values(optimization.take_values());
  if (report.status == OptimizeStatus::singular) {
    NormalEquations<Graph> equations(graph);
    equations.linearize(graph, graph.values());
    report.free = open_parts(SpringedSystem<NormalEquations<Graph>::dof>(equations), graph.values());
  }
  return report;
}

/// How far the worst constraint of a graph is from holding.
template <class Graph>
[[nodiscard]] double violation_of(const Graph& graph, const Values<typename Graph::Value>& values) {
  double worst = 0.0;
  graph.for_each_factor([&](const auto& factor) {
    if constexpr (is_constraint<std::remove_cvref_t<decltype(factor)>>)
      worst = std::max(worst, factor.violation(values));
  });
  return worst;
}

}  // namespace detail

/// Finds the values at which the graph's cost is least, and `Constrained` factors hold, starting from those it has.
///
/// Something must hold each connected part in place: a prior or a fixed variable. Whatever fails is a status, and the
/// graph then keeps its values, bit for bit.
///
/// @param method  GaussNewton, LevenbergMarquardt or Dogleg.
/// @param solver  where the linear systems are solved; keeps its memory for the next call.
template <class Group, class... Extra, class Method, LinearSolver Solver>
OptimizeReport optimize(FactorGraph<Group, Extra...>& graph, const Method& method, Solver& solver) {
  OptimizeReport report = detail::optimize_springs(graph, method, solver);
  if constexpr ((detail::is_constraint<Extra> || ...)) {
    report.violation = detail::violation_of(graph, graph.values());
    for (detail::ConstraintRounds rounds; report.ok() && rounds.more(report.violation);) {
      graph.change_factors([&](auto& factor) {
        if constexpr (requires { factor.tighten(graph.values()); }) factor.tighten(graph.values());
      });
      const OptimizeReport next = detail::optimize_springs(graph, method, solver);
      report.iterations += next.iterations;
      if (!next.ok()) break;
      report.status = next.status;
      report.final_cost = next.final_cost;
      report.violation = detail::violation_of(graph, graph.values());
    }
  }
  return report;
}

template <class Group, class... Extra, class Method = LevenbergMarquardt>
OptimizeReport optimize(FactorGraph<Group, Extra...>& graph, const Method& method = {}) {
  BlockCholesky<Group::dof> solver;
  return optimize(graph, method, solver);
}

/// The same, bit-identically, with the factorizations shared out by an executor.
template <class Group, class... Extra, class Method, Executor Exec>
OptimizeReport optimize(FactorGraph<Group, Extra...>& graph, const Method& method, const Exec& executor) {
  ParallelCholesky<Group::dof, Exec> solver(executor);
  return optimize(graph, method, solver);
}

#ifdef CHAINSLAM_COMPILED
extern template OptimizeReport optimize(PoseGraph&, const GaussNewton&);
extern template OptimizeReport optimize(PoseGraph&, const LevenbergMarquardt&);
extern template OptimizeReport optimize(PoseGraph&, const Dogleg&);
#endif

}  // namespace chainslam
