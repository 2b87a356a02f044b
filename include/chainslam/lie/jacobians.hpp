#pragma once

#include <Eigen/Core>
#include <cmath>
#include <concepts>
#include <limits>
#include <type_traits>

#include "chainslam/lie/concepts.hpp"

namespace chainslam {

namespace detail {

/// x moved by d, for a manifold or an Eigen vector.
template <class X, class Tangent>
[[nodiscard]] X moved(const X& x, const Tangent& d) {
  if constexpr (Manifold<X>)
    return x.retract(d);
  else
    return x + d;
}

/// The tangent at `from` that leads to `to`.
template <class X>
[[nodiscard]] auto difference(const X& from, const X& to) {
  if constexpr (Manifold<X>)
    return typename X::Tangent(from.local(to));
  else
    return X(to - from);
}

template <class X>
struct Dimension : std::integral_constant<int, X::RowsAtCompileTime> {};
template <Manifold X>
struct Dimension<X> : std::integral_constant<int, X::dof> {};

}  // namespace detail

/// d f(x (+) d) (-) f(x) / d d at d = 0, from f at four points a column: the check of every closed form in this
/// library.
///
/// @param f  from X to Y, each a Manifold or an Eigen vector of fixed size; smooth around x.
/// @param x  where; tangents as its own `retract` takes them, those of Y as its `local` gives them.
/// @returns  dim(Y) x dim(X); error about 1e-12 in double and 1e-5 in float for functions of unit scale.
template <class F, class X>
[[nodiscard]] auto numeric_jacobian(F&& f, const X& x) {
  using Y = std::remove_cvref_t<std::invoke_result_t<F&, const X&>>;
  using Scalar = typename X::Scalar;
  constexpr int columns = detail::Dimension<X>::value;
  constexpr int rows = detail::Dimension<Y>::value;
  static_assert(rows > 0 && columns > 0, "numeric_jacobian: sizes must be known at compile time");
  using Direction = Eigen::Matrix<Scalar, columns, 1>;
  const Y y = f(x);
  // The step at which truncation, O(h^4), and rounding, O(epsilon / h), meet.
  const Scalar h = std::pow(std::numeric_limits<Scalar>::epsilon(), Scalar(0.2));
  const auto at = [&](int column, Scalar step) -> Eigen::Matrix<Scalar, rows, 1> {
    return detail::difference<Y>(y, f(detail::moved(x, Direction(step * Direction::Unit(column)))));
  };
  Eigen::Matrix<Scalar, rows, columns> jacobian;
  for (int i = 0; i < columns; ++i) {
    const Eigen::Matrix<Scalar, rows, 1> near = at(i, h) - at(i, -h);
    const Eigen::Matrix<Scalar, rows, 1> far = at(i, 2 * h) - at(i, -2 * h);
    jacobian.col(i) = (Scalar(8) * near - far) / (Scalar(12) * h);
  }
  return jacobian;
}

/// Carries small errors from the tangent space at x to that at y = x.retract(d): to first order in e,
/// x.retract(d + e) = y.retract(retract_jacobian(x, d) * e).
///
/// On a group this is the right Jacobian, whatever x; any other manifold has a member of this name. FAST-LIO2 (Xu et
/// al. 2022, eq. 16) and IKFoM (He et al. 2021, section IV) write its inverse as J.
template <Manifold M>
[[nodiscard]] auto retract_jacobian(const M& x, const typename M::Tangent& d) {
  if constexpr (LieGroup<M>)
    return M::right_jacobian(d);
  else
    return x.retract_jacobian(d);
}

}  // namespace chainslam
