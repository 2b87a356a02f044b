#pragma once

#include <Eigen/Core>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/lie/concepts.hpp"

namespace chainslam {

/// Vectors of R^N under addition: the group of biases, velocities and positions. Default: zero.
template <class Scalar_, int N>
class Rn {
  static_assert(N > 0, "Rn: the dimension N must be known at compile time and positive");

 public:
  using Scalar = Scalar_;                        ///< float, double or an autodiff number
  static constexpr int dof = N;                  ///< dimension of the tangent space
  using Tangent = Eigen::Matrix<Scalar, N, 1>;   ///< element of the tangent space
  using Jacobian = Eigen::Matrix<Scalar, N, N>;  ///< derivative of one tangent by another

  Rn() {
    for (Scalar& coordinate : value_) coordinate = Scalar(0);
  }
  /// The vector `value`.
  explicit Rn(const Tangent& value) {
    for (int i = 0; i < N; ++i) value_[i] = value.data()[i];
  }

  [[nodiscard]] static Rn identity() { return Rn(); }  ///< the neutral element
  /// The group element of a tangent; see the class for the order of its coordinates.
  [[nodiscard]] static Rn exp(const Tangent& v) { return Rn(v); }
  [[nodiscard]] Tangent log() const { return value(); }               ///< the tangent with exp(log()) == *this
  [[nodiscard]] Rn inverse() const { return Rn(negative(value())); }  ///< x * x.inverse() is the identity
  [[nodiscard]] Rn operator*(const Rn& other) const { return Rn(sum_of(value(), other.value())); }  ///< the sum
  Rn& operator*=(const Rn& other) { return *this = *this * other; }  ///< *this = *this * other

  /// value() + v
  [[nodiscard]] Rn retract(const Tangent& v) const { return Rn(sum_of(value(), v)); }
  /// other.value() - value()
  [[nodiscard]] Tangent local(const Rn& other) const { return difference_of(other.value(), value()); }

  /// As a vector.
  [[nodiscard]] Tangent value() const {
    Tangent value;
    for (int i = 0; i < N; ++i) value.data()[i] = value_[i];
    return value;
  }

  /// X exp(d) x^-1 = exp(adjoint() d).
  [[nodiscard]] Jacobian adjoint() const { return chainslam::identity<Jacobian>(); }
  /// Exp(v + d) = exp(left_jacobian(v) d) exp(v) to first order.
  [[nodiscard]] static Jacobian left_jacobian(const Tangent&) { return chainslam::identity<Jacobian>(); }
  /// Inverse of `left_jacobian`.
  [[nodiscard]] static Jacobian left_jacobian_inverse(const Tangent&) { return chainslam::identity<Jacobian>(); }
  /// Exp(v + d) = exp(v) exp(right_jacobian(v) d) to first order.
  [[nodiscard]] static Jacobian right_jacobian(const Tangent&) { return chainslam::identity<Jacobian>(); }
  /// Inverse of `right_jacobian`.
  [[nodiscard]] static Jacobian right_jacobian_inverse(const Tangent&) { return chainslam::identity<Jacobian>(); }

  /// The same with another number type.
  template <class Other>
  [[nodiscard]] Rn<Other, N> cast() const {
    return Rn<Other, N>(value().template cast<Other>());
  }

  /// Whether all members are equal.
  friend bool operator==(const Rn& a, const Rn& b) {
    for (int i = 0; i < N; ++i)
      if (!(a.value_[i] == b.value_[i])) return false;
    return true;
  }

 private:
  Scalar value_[N];  // copies without Eigen's assignments, and without its alignment
};

using R1d = Rn<double, 1>;
using R2d = Rn<double, 2>;
using R3d = Rn<double, 3>;
static_assert(LieGroup<R3d>);

}  // namespace chainslam
