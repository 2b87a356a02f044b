#pragma once

#include <Eigen/Core>
#include <concepts>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/concepts.hpp"

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

}  // namespace chainslam
