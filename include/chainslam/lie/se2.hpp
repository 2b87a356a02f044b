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

/// Rigid motions of the plane: p_a = R_a_b p_b + t_a_b.
///
/// Tangent [x; y; angle] (metres, radians), right perturbation, with the exact exponential (not the first-order
/// retraction (x, y, angle) of some pose-graph packages). Default: identity.
template <class Scalar_>
class SE2 {
 public:
  using Scalar = Scalar_;                        ///< float, double or an autodiff number
  static constexpr int dof = 3;                  ///< dimension of the tangent space
  using Tangent = Eigen::Matrix<Scalar, 3, 1>;   ///< element of the tangent space
  using Jacobian = Eigen::Matrix<Scalar, 3, 3>;  ///< derivative of one tangent by another
  using Vector2 = Eigen::Matrix<Scalar, 2, 1>;   ///< 2-vector
  using Matrix2 = Eigen::Matrix<Scalar, 2, 2>;   ///< 2 x 2 matrix
  using Matrix3 = Eigen::Matrix<Scalar, 3, 3>;   ///< 3 x 3 matrix

  SE2() : translation_(Vector2::Zero()) {}
  /// From its parts.
  SE2(const SO2<Scalar>& rotation, const Vector2& translation) : rotation_(rotation), translation_(translation) {}

  [[nodiscard]] static SE2 identity() { return SE2(); }  ///< the neutral element

  /// From the homogeneous matrix [R t; 0 1]; the last row is not looked at.
  [[nodiscard]] static SE2 from_matrix(const Matrix3& T) {
    return SE2(SO2<Scalar>::from_matrix(T.template topLeftCorner<2, 2>()), T.template topRightCorner<2, 1>());
  }

  /// The group element of a tangent; see the class for the order of its coordinates.
  [[nodiscard]] static SE2 exp(const Tangent& xi) {
    return SE2(SO2<Scalar>::from_angle(xi[2]), average_rotation(xi[2]) * xi.template head<2>());
  }

  /// Angle in [-pi, pi].
  [[nodiscard]] Tangent log() const {
    const Scalar angle = rotation_.angle();
    Tangent xi;
    xi << average_rotation_inverse(angle) * translation_, angle;
    return xi;
  }

  /// X * x.inverse() is the identity.
  [[nodiscard]] SE2 inverse() const {
    const SO2<Scalar> inverse_rotation = rotation_.inverse();
    return SE2(inverse_rotation, -(inverse_rotation * Vector2(translation_)));
  }

  /// Composition: first `other`, then this.
  [[nodiscard]] SE2 operator*(const SE2& other) const {
    return SE2(rotation_ * other.rotation_, *this * Vector2(other.translation_));
  }
  SE2& operator*=(const SE2& other) { return *this = *this * other; }  ///< *this = *this * other

  /// The transformed point.
  [[nodiscard]] Vector2 operator*(const Vector2& p) const { return rotation_ * p + translation_; }

  /// *this * exp(xi)
  [[nodiscard]] SE2 retract(const Tangent& xi) const { return *this * exp(xi); }
  /// log(inverse() * other): retract(local(other)) is `other`.
  [[nodiscard]] Tangent local(const SE2& other) const { return (inverse() * other).log(); }

  [[nodiscard]] const SO2<Scalar>& rotation() const { return rotation_; }  ///< the rotational part
  [[nodiscard]] Vector2 translation() const { return translation_; }       ///< the translational part

  /// As a matrix.
  [[nodiscard]] Matrix3 matrix() const {
    Matrix3 T = Matrix3::Identity();
    T.template topLeftCorner<2, 2>() = rotation_.matrix();
    T.template topRightCorner<2, 1>() = translation_;
    return T;
  }

  /// T exp(xi) T^-1 = exp(adjoint() xi)
  [[nodiscard]] Jacobian adjoint() const {
    return blocks(rotation_.matrix(), Vector2(translation_[1], -translation_[0]));
  }

  /// exp(xi + d) = exp(left_jacobian(xi) d) * exp(xi) to first order (Sola et al. 2018, eq. 164).
  [[nodiscard]] static Jacobian left_jacobian(const Tangent& xi) {
    return blocks(average_rotation(xi[2]), coupling(xi));
  }
  /// Singular where the angle is 2 pi.
  [[nodiscard]] static Jacobian left_jacobian_inverse(const Tangent& xi) {
    const Matrix2 inverse = average_rotation_inverse(xi[2]);
    return blocks(inverse, -inverse * coupling(xi));
  }
  /// exp(xi + d) = exp(xi) * exp(right_jacobian(xi) d) to first order.
  [[nodiscard]] static Jacobian right_jacobian(const Tangent& xi) { return left_jacobian(-xi); }
  /// Singular where the angle is 2 pi.
  [[nodiscard]] static Jacobian right_jacobian_inverse(const Tangent& xi) { return left_jacobian_inverse(-xi); }

  /// Brings the rotation back to unit length.
  void normalize() { rotation_.normalize(); }

  /// The same with another number type.
  template <class Other>
  [[nodiscard]] SE2<Other> cast() const {
    return SE2<Other>(rotation_.template cast<Other>(), translation().template cast<Other>());
  }

  /// Whether all members are equal.
  friend bool operator==(const SE2& a, const SE2& b) {
    return a.rotation_ == b.rotation_ && a.translation_ == b.translation_;
  }

 private:
  [[nodiscard]] static Jacobian blocks(const Matrix2& linear, const Vector2& column) {
    Jacobian matrix = Jacobian::Identity();
    matrix.template topLeftCorner<2, 2>() = linear;
    matrix.template topRightCorner<2, 1>() = column;
    return matrix;
  }

  /// The matrix of the complex number re + i im.
  [[nodiscard]] static Matrix2 complex_matrix(const Scalar& re, const Scalar& im) {
    Matrix2 matrix;
    matrix << re, -im, im, re;
    return matrix;
  }

  /// Mean of the rotations from 0 to `angle`.
  [[nodiscard]] static Matrix2 average_rotation(const Scalar& angle) {
    const Scalar x = angle * angle;
    return complex_matrix(detail::sinc(x), angle * detail::jacobian_coefficients<Scalar>(x).b);
  }
  [[nodiscard]] static Matrix2 average_rotation_inverse(const Scalar& angle) {
    const Scalar x = angle * angle;
    return complex_matrix(detail::constant<Scalar>(1) - x * detail::inverse_jacobian_coefficient<Scalar>(x),
                          -angle * detail::constant<Scalar>(0.5L));
  }

  /// Last column of the left Jacobian: SE(3)'s block Q for a motion in the plane.
  [[nodiscard]] static Vector2 coupling(const Tangent& xi) {
    const auto coefficients = detail::jacobian_coefficients<Scalar>(xi[2] * xi[2]);
    const Scalar along = coefficients.c * xi[2];
    return Vector2(coefficients.b * xi[1] + along * xi[0], along * xi[1] - coefficients.b * xi[0]);
  }

  SO2<Scalar> rotation_;
  Eigen::Matrix<Scalar, 2, 1, Eigen::DontAlign> translation_;
};

using SE2d = SE2<double>;
using SE2f = SE2<float>;
static_assert(LieGroup<SE2d>);
static_assert(sizeof(SE2d) == 4 * sizeof(double) && alignof(SE2d) == alignof(double));

}  // namespace chainslam
