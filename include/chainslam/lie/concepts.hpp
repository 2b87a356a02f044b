#pragma once

#include <concepts>

namespace chainslam {

/// A smooth space that looks like R^dof around each point.
///
/// Laws, for x, y near each other and d small (on spheres and rotations: within pi):
/// - `x.retract(0)` is x; `x.local(x)` is 0;
/// - `x.retract(x.local(y))` is y; `x.local(x.retract(d))` is d;
/// - both are smooth there, and `retract` moves with unit speed at 0.
template <class M>
concept Manifold = std::copyable<M> && std::default_initializable<M> &&
    requires(const M& x, const M& y, const typename M::Tangent& d) {
  typename M::Scalar;
  { M::dof } -> std::convertible_to<int>;
  { x.retract(d) } -> std::same_as<M>;
  { x.local(y) } -> std::convertible_to<typename M::Tangent>;
};

/// A group that is a manifold; the tangent acts from the right: `retract(d)` is `x * exp(d)` (Sola et al. 2018).
///
/// Laws:
/// - `*` is associative, `identity()` neutral, `x * x.inverse()` the identity; a default-constructed x is the identity;
/// - `exp(x.log())` is x; `exp(d).log()` is d where rotations stay within pi; `exp(d).inverse()` is `exp(-d)`;
/// - `x * exp(d) * x.inverse()` is `exp(x.adjoint() * d)`; the adjoint of a product is the product of the adjoints;
/// - to first order in e, exp(d + e) = exp(left_jacobian(d) e) * exp(d) = exp(d) * exp(right_jacobian(d) e);
///   left_jacobian(d) = exp(d).adjoint() * right_jacobian(d); right_jacobian(d) = left_jacobian(-d);
/// - the inverse Jacobians are their inverses, away from rotations by 2 pi.
template <class G>
concept LieGroup = Manifold<G> && requires(const G& x, const G& y, const typename G::Tangent& d) {
  typename G::Jacobian;
  { G::identity() } -> std::same_as<G>;
  { G::exp(d) } -> std::same_as<G>;
  { x.log() } -> std::same_as<typename G::Tangent>;
  { x.inverse() } -> std::same_as<G>;
  { x* y } -> std::same_as<G>;
  { x.adjoint() } -> std::same_as<typename G::Jacobian>;
  { G::left_jacobian(d) } -> std::same_as<typename G::Jacobian>;
  { G::right_jacobian(d) } -> std::same_as<typename G::Jacobian>;
  { G::left_jacobian_inverse(d) } -> std::same_as<typename G::Jacobian>;
  { G::right_jacobian_inverse(d) } -> std::same_as<typename G::Jacobian>;
};

/// The point at `t` on the geodesic from `a` (t = 0, exactly) to `b` (t = 1, exactly); other t extrapolate.
///
/// On SE(3) this is the screw motion with constant body velocity; on SO(3) it is slerp by the shorter way.
template <Manifold M>
[[nodiscard]] M interpolate(const M& a, const M& b, typename M::Scalar t) {
  using Scalar = typename M::Scalar;
  if (t == Scalar(0)) return a;
  if (t == Scalar(1)) return b;
  return a.retract(t * a.local(b));
}

}  // namespace chainslam
