#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <concepts>
#include <utility>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/concepts.hpp"
#include "chainslam/lie/jacobians.hpp"

namespace chainslam {

/// Where a process takes a state, and what becomes of errors on the way: e' = F e + w with w ~ N(0, Q), e and e' in the
/// tangent spaces at the old and the new state.
template <Manifold State>
struct Transition {
  using Matrix = Eigen::Matrix<typename State::Scalar, State::dof, State::dof>;  ///< `dof` x `dof`
  State state;                                                                   ///< afterwards
  Matrix F;  ///< jacobian of the error's propagation
  Matrix Q;  ///< covariance of the process noise
};

/// What measurements say of a state x, to second order: with residuals r(x) of covariance R and H = dr / dx,
/// |r(x (+) d)|^2 = squared_error - 2 gradient . d + d . information d, each |.|^2 weighted by R^-1.
///
/// Sums over residuals, so that no m x n Jacobian is ever written out. A direction that must not be updated through has
/// no part in `information` and `gradient`.
template <Manifold State>
struct Linearization {
  using Tangent = typename State::Tangent;                                       ///< tangent of the state
  using Matrix = Eigen::Matrix<typename State::Scalar, State::dof, State::dof>;  ///< `dof` x `dof`
  Matrix information = zeros<Matrix>();                                          ///< H^T R^-1 H
  Tangent gradient = zeros<Tangent>();                                           ///< -H^T R^-1 r
  typename State::Scalar squared_error = 0;                                      ///< r^T R^-1 r
  Index residuals = 0;                                                           ///< 0: the measurement says nothing
  bool settled = true;  ///< these residuals are final: a small step now ends the iteration
};

/// Moves a state through time. `Input` is what drives it for `dt` seconds, such as an IMU measurement.
template <class P, class State>
concept ProcessModel = Manifold<State> &&
    requires(const P& process, const State& x, const typename P::Input& input, double dt) {
  { process.predict(x, input, dt) } -> std::same_as<Transition<State>>;
};

/// Measures a state. `linearize(x, renew)` may keep what it has matched from one call to the next; `renew` says that
/// the iteration has come to rest on that, or has one pass left.
template <class M, class State>
concept MeasurementModel = Manifold<State> && requires(M& measurement, const State& x, bool renew) {
  { measurement.linearize(x, renew) } -> std::same_as<Linearization<State>>;
};

/// Convergence criteria of an iterated update.
struct IterationRule {
  Index max_iterations = 5;      ///< passes, at most
  double step_tolerance = 1e-3;  ///< of every coordinate of the step (FAST-LIO2's code: 0.001)
};

enum class FilterStatus {
  converged,
  iteration_limit,  ///< the last step was not small; taken all the same
  no_information,   ///< a pass had no residuals; the state is the prediction
  not_finite,       ///< an overflow or a broken measurement; the state is the prediction
};

/// What an update did.
template <Manifold State>
struct FilterReport {
  FilterStatus status = FilterStatus::no_information;  ///< how it ended
  Index iterations = 0;                                ///< passes made
  Index residuals = 0;                                 ///< of the last pass
  /// Normalized innovation squared, r^T (H P H^T + R)^-1 r at the prediction: `nis_residuals` on average if prior and
  /// measurement are as good as they say (Bar-Shalom, Li and Kirubarajan 2001, section 5.4).
  double nis = 0;
  Index nis_residuals = 0;  ///< residuals of the first pass
  double prior_error = 0;   ///< what the correction costs by the prior: d^T P^-1 d
  typename State::Tangent correction = zeros<typename State::Tangent>();  ///< from the prediction to the estimate

  /// Whether state and covariance were updated.
  [[nodiscard]] bool accepted() const {
    return status == FilterStatus::converged || status == FilterStatus::iteration_limit;
  }
};

/// Iterated error-state Kalman filter on a manifold: FAST-LIO2's (Xu et al. 2022, algorithm 1) in the form of IKFoM (He
/// et al. 2021, arXiv 2102.03804).
///
/// The state is any `Manifold`, such as a `Product` of groups and spheres; covariances are in the tangent space at the
/// state. The update is Gauss-Newton for the maximum a posteriori. With P = L L^T the posterior covariance is
/// L (I + L^T H^T R^-1 H L)^-1 L^T: what Joseph's form gives, symmetric and semi-definite in any rounding, by one
/// factorization the size of the state; P is never inverted, so that coordinates without variance stay where they are.
///
/// @tparam Process  see `ProcessModel`; a public member with its settings.
template <Manifold State, class Process>
class Ieskf {
  static_assert(ProcessModel<Process, State>,
                "Ieskf: Process needs `Transition<State> predict(const State&, const Input&, double dt) const`; see "
                "chainslam/odometry/ieskf.hpp");

 public:
  using Tangent = typename State::Tangent;  ///< tangent of the state
  /// Covariance in the tangent space, `dof` x `dof`.
  using Matrix = Eigen::Matrix<typename State::Scalar, State::dof, State::dof>;
  using Input = typename Process::Input;  ///< what drives the process

  Ieskf() = default;
  /// Starts at `state`, with `covariance` in its tangent space.
  Ieskf(const State& state, const Matrix& covariance, Process model = {})
      : process(std::move(model)), state_(state), covariance_(covariance) {}

  Process process{};  ///< the process model with its settings

  [[nodiscard]] const State& state() const { return state_; }  ///< the estimate
  /// Covariance of the estimate in its tangent space, `dof` x `dof`.
  [[nodiscard]] const Matrix& covariance() const { return covariance_; }

  /// Sets the state and its covariance, which must be symmetric and semi-definite.
  void reset(const State& state, const Matrix& covariance) {
    state_ = state;
    covariance_ = covariance;
  }

  /// Propagates the state by `dt` > 0 seconds (FAST-LIO2, eq. 7 and 8).
  void predict(const Input& input, double dt) {
    const Transition<State> step = process.predict(state_, input, dt);
    state_ = step.state;
    covariance_ = symmetric(sum_of(congruent(step.F, covariance_), step.Q));
  }

  /// Measurement update. Whatever the outcome, state and covariance stay finite.
  template <MeasurementModel<State> Measurement>
  FilterReport<State> update(Measurement& measurement, const IterationRule& rule = {}) {
    return update(measurement, rule, State(state_));
  }
  /// The same, with iterations that start at `guess` in place of the prediction.
  template <MeasurementModel<State> Measurement>
  FilterReport<State> update(Measurement& measurement, const IterationRule& rule, const State& guess);

 private:
  /// (H^T R^-1 H + P^-1)^-1 for P = root root^T, as C C^T for the C returned.
  [[nodiscard]] static Matrix posterior_root(const Matrix& root, const Matrix& information) {
    const Matrix weighed = times(information, root);
    Matrix whitened = symmetric(times(transposed(root), weighed));
    for (int i = 0; i < State::dof; ++i) whitened(i, i) += 1;
    return solved_right(root, cholesky(whitened));
  }

  [[nodiscard]] static bool is_small(const Tangent& step, double tolerance) {
    for (int i = 0; i < State::dof; ++i)
      if (!(std::abs(step[i]) < tolerance)) return false;
    return true;
  }

  State state_{};
  Matrix covariance_ = identity<Matrix>();
};

template <Manifold State, class Process>
template <MeasurementModel<State> Measurement>
FilterReport<State> Ieskf<State, Process>::update(Measurement& measurement, const IterationRule& rule,
                                                  const State& guess) {
  FilterReport<State> report;
  const Matrix prior_root = square_root(covariance_);
  State x = guess;
  Matrix covariance = covariance_;
  for (bool renew = false; report.iterations < rule.max_iterations;) {
    const Tangent moved = state_.local(x);
    const Matrix J_inverse = retract_jacobian(state_, moved);  // FAST-LIO2, eq. 16
    const Linearization<State> z = measurement.linearize(x, renew || report.iterations + 1 == rule.max_iterations);
    report.residuals = z.residuals;
    if (z.residuals == 0) {
      report.status = FilterStatus::no_information;
      return report;
    }
    const Matrix C = posterior_root(times(J_inverse, prior_root), z.information);
    const Matrix S = times_transposed(C, C);
    // FAST-LIO2, eq. 18, with K H = S H^T R^-1 H and K r = -S gradient.
    const Tangent back = times(J_inverse, moved);
    const Tangent pull = sum_of(z.gradient, times(z.information, back));
    const Tangent step = difference_of(times(S, pull), back);
    if (!is_finite(step) || !is_finite(S)) {
      report.status = FilterStatus::not_finite;
      return report;
    }
    if (report.iterations == 0) {
      const Tangent both = sum_of(z.gradient, pull);
      const double at_prediction = z.squared_error + transposed_product(back, both)(0, 0);
      report.nis = at_prediction - transposed_product(pull, times(S, pull))(0, 0);
      report.nis_residuals = z.residuals;
    }
    // After the step prior and measurement balance: P^-1 d = gradient - information step.
    const Tangent whole = sum_of(back, step), balance = difference_of(z.gradient, times(z.information, step));
    report.prior_error = transposed_product(whole, balance)(0, 0);
    // The posterior lives where the step ends: IKFoM's reset, which later filters dropped.
    const Matrix reset = retract_jacobian(x, step);
    x = x.retract(step);
    covariance = symmetric(congruent(reset, S));
    ++report.iterations;
    renew = is_small(step, rule.step_tolerance);
    report.status = renew && z.settled ? FilterStatus::converged : FilterStatus::iteration_limit;
    if (report.status == FilterStatus::converged) break;
  }
  if (!report.accepted()) return report;
  report.correction = state_.local(x);
  reset(x, covariance);
  return report;
}

}  // namespace chainslam
