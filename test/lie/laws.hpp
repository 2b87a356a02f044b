#pragma once

#include <doctest/doctest.h>

#include <Eigen/Core>
#include <cmath>
#include <limits>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/lie/concepts.hpp"
#include "chainslam/lie/jacobians.hpp"
#include "chainslam/lie/rn.hpp"
#include "support/property.hpp"

namespace chainslam::test {

/// A tangent with components in [-scale, scale].
template <class Tangent>
[[nodiscard]] Tangent random_tangent(Rng& rng, double scale) {
  Tangent d;
  for (Eigen::Index i = 0; i < d.size(); ++i) d[i] = static_cast<typename Tangent::Scalar>(rng.uniform(-scale, scale));
  return d;
}

/// Tiny, small, middling and large tangents in turn; rotations stay below 1.7 sqrt(3) < pi.
template <class Tangent>
[[nodiscard]] Tangent random_tangent(Rng& rng) {
  static constexpr double scales[] = {1e-9, 1e-3, 0.3, 1.7};
  return random_tangent<Tangent>(rng, scales[rng.uniform_index(4)]);
}

/// A point some way from the default one.
template <Manifold M>
[[nodiscard]] M random_point(Rng& rng) {
  return M().retract(random_tangent<typename M::Tangent>(rng)).retract(random_tangent<typename M::Tangent>(rng));
}

template <class Scalar, int Rows, int Columns>
[[nodiscard]] bool near_matrices(const Eigen::Matrix<Scalar, Rows, Columns>& a,
                                 const Eigen::Matrix<Scalar, Rows, Columns>& b, double tolerance) {
  double squares = 0;
  for (Eigen::Index i = 0; i < a.size(); ++i) {
    const auto difference = static_cast<double>(a.data()[i] - b.data()[i]);
    squares += difference * difference;
  }
  return std::sqrt(squares) <= tolerance;  // false for NaN
}

/// |a - b| <= tolerance. Compiled once for each shape, not for each pair of expressions.
template <class A, class B>
[[nodiscard]] bool near(const A& a, const B& b, double tolerance) {
  using Matrix = Eigen::Matrix<typename A::Scalar, A::RowsAtCompileTime, A::ColsAtCompileTime>;
  return near_matrices<typename A::Scalar, A::RowsAtCompileTime, A::ColsAtCompileTime>(Matrix(a), Matrix(b), tolerance);
}

/// Rounding of a dozen operations on numbers up to about 10 (translations of the tests, scales of the similarities).
template <class M>
inline constexpr double rounding = 200.0 * static_cast<double>(std::numeric_limits<typename M::Scalar>::epsilon());

/// The laws in the comment of `Manifold`.
template <Manifold M>
void check_manifold_laws() {
  using Tangent = typename M::Tangent;
  const Tangent zero = zeros<Tangent>();
  for_all(200, [&](Rng& rng, int) {
    const M x = random_point<M>(rng);
    const Tangent d = random_tangent<Tangent>(rng);
    const M y = x.retract(d);
    CHECK(near(x.local(x.retract(zero)), zero, rounding<M>));
    CHECK(near(x.local(x), zero, rounding<M>));
    CHECK(near(x.local(y), d, rounding<M>));
    CHECK(near(y.local(x.retract(x.local(y))), zero, rounding<M>));
    if constexpr (std::is_same_v<typename M::Scalar, double>) {
      using Coordinates = Rn<double, M::dof>;
      const auto jacobian =
          numeric_jacobian([&](const Coordinates& c) { return M(x.retract(c.value())); }, Coordinates());
      CHECK(near(jacobian, identity<Eigen::Matrix<double, M::dof, M::dof>>(), 1e-10));
      const auto carried = numeric_jacobian(
          [&](const Coordinates& e) { return Coordinates(y.local(x.retract(sum_of(d, Tangent(e.value()))))); },
          Coordinates());
      CHECK(near(carried, retract_jacobian(x, d), 1e-9));
    }
  });
}

/// The laws in the comment of `LieGroup`.
template <LieGroup G>
void check_lie_group_laws() {
  using Tangent = typename G::Tangent;
  using Jacobian = typename G::Jacobian;
  const Tangent zero = zeros<Tangent>();
  const double tolerance = rounding<G>;
  CHECK(G() == G::identity());
  for_all(200, [&](Rng& rng, int) {
    const G x = random_point<G>(rng);
    const G y = random_point<G>(rng);
    const G z = random_point<G>(rng);
    const Tangent d = random_tangent<Tangent>(rng);

    CHECK(near(((x * y) * z).local(x * (y * z)), zero, 10 * tolerance));
    CHECK(near(x.local(x * G::identity()), zero, tolerance));
    CHECK(near(x.local(G::identity() * x), zero, tolerance));
    CHECK(near((x * x.inverse()).log(), zero, 10 * tolerance));
    CHECK(near((x.inverse() * x).log(), zero, 10 * tolerance));
    CHECK(near(G::exp(x.log()).local(x), zero, tolerance));
    CHECK(near(G::exp(d).log(), d, tolerance));
    CHECK(near((G::exp(d).inverse()).local(G::exp(negative(d))), zero, 10 * tolerance));
    CHECK(near(x.retract(d).local(x * G::exp(d)), zero, tolerance));

    const Tangent small = random_tangent<Tangent>(rng, 0.05);
    const Tangent conjugate = product(Jacobian(x.adjoint()), small);
    CHECK(near((x * G::exp(small) * x.inverse()).local(G::exp(conjugate)), zero, 100 * tolerance));
    CHECK(near((x * y).adjoint(), product(Jacobian(x.adjoint()), Jacobian(y.adjoint())), 100 * tolerance));

    const Jacobian left = G::left_jacobian(d);
    const Jacobian right = G::right_jacobian(d);
    CHECK(near(left, product(Jacobian(G::exp(d).adjoint()), right), 10 * tolerance));
    CHECK(near(right, G::left_jacobian(negative(d)), tolerance));
    CHECK(near(product(left, Jacobian(G::left_jacobian_inverse(d))), identity<Jacobian>(), 10 * tolerance));
    CHECK(near(product(Jacobian(G::right_jacobian_inverse(d)), right), identity<Jacobian>(), 10 * tolerance));
  });
}

/// Both Jacobians against derivatives by differences; 1e-10 is what `numeric_jacobian` promises, with room for scales
/// of e^3.
template <LieGroup G>
void check_numeric_jacobians() {
  using Tangent = typename G::Tangent;
  using Coordinates = Rn<double, G::dof>;
  for_all(60, [](Rng& rng, int) {
    const Coordinates d(random_tangent<Tangent>(rng));
    const G at = G::exp(d.value());
    const auto right = numeric_jacobian([](const Coordinates& c) { return G::exp(c.value()); }, d);
    const auto left = numeric_jacobian(
        [&](const Coordinates& c) { return Coordinates((G::exp(c.value()) * at.inverse()).log()); }, d);
    CHECK(near(right, G::right_jacobian(d.value()), 1e-10));
    CHECK(near(left, G::left_jacobian(d.value()), 1e-10));
    // d log(x exp(e)) / d e: how residuals of factors turn.
    const auto of_log = numeric_jacobian([](const G& x) { return Coordinates(x.log()); }, at);
    CHECK(near(of_log, G::right_jacobian_inverse(d.value()), 1e-9));
  });
}

}  // namespace chainslam::test
