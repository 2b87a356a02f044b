#pragma once

#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/free_part.hpp"
#include "chainslam/factor_graph/values.hpp"

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

/// What `optimise` did. Costs are sums of squared whitened residuals (chi^2), through the kernels.
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

}  // namespace chainslam
