#pragma once

#include <Eigen/Core>
#include <cmath>

#include "chainslam/lie/concepts.hpp"
#include "chainslam/lie/detail/rotation_series.hpp"

namespace chainslam {

/// Rotations of the plane: unit complex numbers. Tangent: the angle, radians. Default: identity.
template <class Scalar_>
class SO2 {
 public:
  using Scalar = Scalar_;                        ///< float, double or an autodiff number
  static constexpr int dof = 1;                  ///< dimension of the tangent space
  using Tangent = Eigen::Matrix<Scalar, 1, 1>;   ///< element of the tangent space
  using Jacobian = Eigen::Matrix<Scalar, 1, 1>;  ///< derivative of one tangent by another
  using Vector2 = Eigen::Matrix<Scalar, 2, 1>;   ///< 2-vector
  using Matrix2 = Eigen::Matrix<Scalar, 2, 2>;   ///< 2 x 2 matrix

  SO2() : complex_(detail::constant<Scalar>(1), detail::constant<Scalar>(0)) {}

  [[nodiscard]] static SO2 identity() { return SO2(); }  ///< the neutral element

  /// From an angle, radians.
  [[nodiscard]] static SO2 from_angle(const Scalar& angle) {
    using std::cos, std::sin;
    return SO2(Vector2(cos(angle), sin(angle)));
  }

  /// From a matrix near a rotation: the nearest one.
  [[nodiscard]] static SO2 from_matrix(const Matrix2& R) {
    SO2 result(Vector2(R(0, 0) + R(1, 1), R(1, 0) - R(0, 1)));
    result.normalize();
    return result;
  }

  /// The group element of a tangent; see the class for the order of its coordinates.
  [[nodiscard]] static SO2 exp(const Tangent& w) { return from_angle(w[0]); }

  /// The angle in [-pi, pi].
  [[nodiscard]] Tangent log() const { return Tangent(angle()); }
  /// In [-pi, pi], radians.
  [[nodiscard]] Scalar angle() const {
    using std::atan2;
    return atan2(complex_[1], complex_[0]);
  }

  /// X * x.inverse() is the identity.
  [[nodiscard]] SO2 inverse() const { return SO2(Vector2(complex_[0], -complex_[1])); }

  /// Composition: first `other`, then this.
  [[nodiscard]] SO2 operator*(const SO2& other) const {
    Vector2 product = *this * other.complex_;
    // One Newton step towards length 1: exact to rounding, as both factors are.
    product *= detail::constant<Scalar>(1.5L) - product.squaredNorm() * detail::constant<Scalar>(0.5L);
    return SO2(product);
  }
  SO2& operator*=(const SO2& other) { return *this = *this * other; }  ///< *this = *this * other

  /// The rotated vector.
  [[nodiscard]] Vector2 operator*(const Vector2& p) const {
    return Vector2(complex_[0] * p[0] - complex_[1] * p[1], complex_[1] * p[0] + complex_[0] * p[1]);
  }

  /// *this * exp(w)
  [[nodiscard]] SO2 retract(const Tangent& w) const { return *this * exp(w); }
  /// log(inverse() * other): retract(local(other)) is `other`.
  [[nodiscard]] Tangent local(const SO2& other) const { return (inverse() * other).log(); }

  /// As a matrix.
  [[nodiscard]] Matrix2 matrix() const {
    Matrix2 R;
    R << complex_[0], -complex_[1], complex_[1], complex_[0];
    return R;
  }
  /// (cos, sin) of the angle.
  [[nodiscard]] Vector2 complex() const { return complex_; }

  [[nodiscard]] Jacobian adjoint() const { return Jacobian::Identity(); }  ///< x exp(d) x^-1 = exp(adjoint() d)
  /// Exp(v + d) = exp(left_jacobian(v) d) exp(v) to first order.
  [[nodiscard]] static Jacobian left_jacobian(const Tangent&) { return Jacobian::Identity(); }
  /// Inverse of `left_jacobian`.
  [[nodiscard]] static Jacobian left_jacobian_inverse(const Tangent&) { return Jacobian::Identity(); }
  /// Exp(v + d) = exp(v) exp(right_jacobian(v) d) to first order.
  [[nodiscard]] static Jacobian right_jacobian(const Tangent&) { return Jacobian::Identity(); }
  /// Inverse of `right_jacobian`.
  [[nodiscard]] static Jacobian right_jacobian_inverse(const Tangent&) { return Jacobian::Identity(); }

  /// Brings the complex number back to unit length.
  void normalize() { complex_ /= complex_.norm(); }

  /// The same with another number type.
  template <class Other>
  [[nodiscard]] SO2<Other> cast() const {
    return SO2<Other>::from_matrix(matrix().template cast<Other>());
  }

  /// Whether all members are equal.
  friend bool operator==(const SO2& a, const SO2& b) { return a.complex_ == b.complex_; }

 private:
  explicit SO2(const Vector2& unit) : complex_(unit) {}

  Eigen::Matrix<Scalar, 2, 1, Eigen::DontAlign> complex_;
};

using SO2d = SO2<double>;
using SO2f = SO2<float>;
static_assert(LieGroup<SO2d>);

}  // namespace chainslam
