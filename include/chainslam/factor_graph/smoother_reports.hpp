#pragma once

#include <type_traits>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/free_part.hpp"
#include "chainslam/factor_graph/values.hpp"
#include "chainslam/sparse/incremental_cholesky.hpp"

namespace chainslam {

/// How `IncrementalSmoother` trades accuracy for time. Shares are of the squared error (chi^2).
struct SmootherOptions {
  /// By this share the estimate may be worse than the best one of the linearized factors.
  double linear_tolerance = 3e-5;
  /// A factor is relinearized when its residual differs from the linear prediction by more than its part of this
  /// share. 0: always.
  double nonlinear_tolerance = 3e-5;
  /// Those factors wait until the estimate may be worse because of them by this part of `nonlinear_tolerance` in all,
  /// or until what they are eliminated in is recomputed for another reason. 0: not beyond the next update.
  double patience = 0.2;
  /// A variable's factors are not looked at before its estimate has moved by this much (in the tangent space's units)
  /// since they were linearized, and then whenever it has moved half as far again.
  double first_look = 5e-3;
  /// Beyond this, a variable's factors are relinearized in any case.
  double longest_step = 1.0;
  /// The shares are of a squared error of at least this.
  double least_error = 1e-3;
  /// At most so many variables' factors are relinearized in an update; the rest wait for the next. It bounds the
  /// time of an update, and in long bursts saves work, since the rest is then nearer to where it will end. In graphs
  /// of above 50 000 variables more, in proportion.
  Index largest_relinearization = 300;
  /// Newest variables that are eliminated last.
  Index late_variables = 10;
  /// `IncrementalCholesky::Options::forgotten_share`: more takes less memory and more time.
  double forgotten_share = 1.0;
  /// Newest variables that are kept: `update` marginalizes older ones. 0: all are kept.
  Index lag = 0;
};

/// Options of an `IncrementalSmoother` without lag.
struct NoLag {};

enum class UpdateStatus {
  updated,
  unconstrained,  ///< no prior, no fixed variable and the like hold parts of the graph in all directions; `variables`
                  ///< has each one's least key, `free` the directions
  singular,       ///< a direction of variable `variables[0]` is not measured, given those eliminated before it
  not_finite,     ///< a residual is not a number: check values and measurements; `variables` has its factor's keys
};

/// What an update of `IncrementalSmoother` did.
struct UpdateReport {
  UpdateStatus status = UpdateStatus::updated;  ///< how it ended
  std::vector<Key> variables;                   ///< keys that a failure concerns
  std::vector<FreePart> free;  ///< what is free to move, if that made it fail; `describe` says it in words
  double squared_error = 0.0;  ///< chi^2 of the estimate, as the linearized factors see it
  double gap = 0.0;            ///< how much of it may be left to gain: by the linear system and by what waits
  Index relinearized = 0;      ///< factors
  Index waiting = 0;           ///< variables whose factors the next update will linearize again
  FactorizationWork work;      ///< of the factorization

  [[nodiscard]] bool ok() const { return status == UpdateStatus::updated; }  ///< whether the estimate was updated
};

/// `converge` ends in the local optimum of the estimate it starts from.
struct NoRestart {};

/// `converge` starts again from the chordal relaxation where full steps raise the squared error or it ends above what
/// its degrees of freedom let expect. The lower optimum counts. A type, not a setting: the relaxation has a solver of
/// its own, which programs that do not ask for it need not compile.
struct ChordalRestart {};

/// When `converge` is done, and how it goes on where full steps fail.
template <class Restart = ChordalRestart>
struct ConvergeOptions {
  static_assert(std::is_same_v<Restart, ChordalRestart> || std::is_same_v<Restart, NoRestart>,
                "chainslam: ConvergeOptions takes ChordalRestart or NoRestart");

  Index max_iterations = 50;  ///< linear systems solved, at most
  /// Done when a full step is predicted to gain less than this share of the squared error,
  double relative_tolerance = 1e-9;
  /// or less than this.
  double absolute_tolerance = 1e-9;
};

/// What led to where `converge` ended: a local optimum always, not always the global one.
enum class ConvergeMethod {
  gauss_newton,         ///< full steps, from the estimate as it was
  levenberg_marquardt,  ///< damped steps, since a full one would have raised the squared error
  chordal_restart,      ///< damped steps from the chordal relaxation, which ended lower
};

/// What `converge` did.
struct ConvergeReport {
  UpdateStatus status = UpdateStatus::updated;           ///< how it ended
  std::vector<Key> variables;                            ///< as in `UpdateReport`
  std::vector<FreePart> free;                            ///< as in `UpdateReport`
  ConvergeMethod method = ConvergeMethod::gauss_newton;  ///< what led there
  bool converged = false;                                ///< else the iterations did not suffice
  Index iterations = 0;                                  ///< linear systems solved
  double initial_cost = 0.0;                             ///< before
  double final_cost = 0.0;                               ///< chi^2 through the kernels
  double gap = 0.0;        ///< what the last step was predicted to gain, which bounds what is left to the optimum
  double violation = 0.0;  ///< how far the worst row of `Constrained` factors is from zero, in its own units

  [[nodiscard]] bool ok() const { return status == UpdateStatus::updated; }  ///< whether the estimate was updated
};

/// What adding or taking out several factors together would do.
struct JointForecast {
  double change = 0.0;  ///< of the squared error: its rise or its fall
  /// The change is at least (rise) or at most (fall) this times the factors' squared residuals at the estimate. Stays
  /// true, but for relinearization, until information is lost (`IncrementalSmoother::losses`).
  double per_residual = 0.0;
};

/// What a factor would do if it were added.
struct FactorForecast {
  double squared_residual = 0.0;  ///< at the estimate as it is
  /// What the squared error would rise by, with the factor and the rest giving way to each other: chi^2 distributed
  /// with as many degrees of freedom as the factor has rows, if it agrees with the rest.
  double rise = 0.0;
};

}  // namespace chainslam
