#pragma once

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/lie/so3.hpp"

namespace chainslam {

/// Rigid motions: p_a = R_a_b p_b + t_a_b.
///
/// Tangent [translation; rotation] (metres, radians), right perturbation T * exp(xi) (Sola et al. 2018), as in manif,
/// Sophus and g2o. Jacobians in closed form (Barfoot and Furgale 2014). Default: identity. Seven scalars, no alignment
/// that depends on compiler flags.
template <class Scalar_>
class SE3 {
 public:
  using Scalar = Scalar_;                        ///< float, double or an autodiff number
  static constexpr int dof = 6;                  ///< dimension of the tangent space
  using Tangent = Eigen::Matrix<Scalar, 6, 1>;   ///< element of the tangent space
  using Jacobian = Eigen::Matrix<Scalar, 6, 6>;  ///< derivative of one tangent by another
  using Vector3 = Eigen::Matrix<Scalar, 3, 1>;   ///< 3-vector
  using Matrix3 = Eigen::Matrix<Scalar, 3, 3>;   ///< 3 x 3 matrix
  using Matrix4 = Eigen::Matrix<Scalar, 4, 4>;   ///< 4 x 4 matrix

  SE3() : translation_(zeros<Vector3>()) {}
  /// From its parts.
  SE3(const SO3<Scalar>& rotation, const Vector3& translation) : rotation_(rotation), translation_(translation) {}

  [[nodiscard]] static SE3 identity() { return SE3(); }  ///< the neutral element

  /// From the homogeneous matrix [R t; 0 1]; R as in `SO3::from_matrix`, the last row is not looked at.
  [[nodiscard]] static SE3 from_matrix(const Matrix4& T) {
    return SE3(SO3<Scalar>::from_matrix(block_of<3, 3>(T, 0, 0)), block_of<3, 1>(T, 0, 3));
  }

  /// The group element of a tangent; see the class for the order of its coordinates.
  [[nodiscard]] static SE3 exp(const Tangent& xi) {
    const Vector3 v = linear(xi), w = angular(xi);
    const auto coefficients = detail::jacobian_coefficients<Scalar>(w.squaredNorm());
    return SE3(SO3<Scalar>::exp(w), axial_product(v, coefficients.b, coefficients.c, w));
  }

  /// Rotation part within pi, see `SO3::log`.
  [[nodiscard]] Tangent log() const {
    const Vector3 w = rotation_.log();
    const Vector3 v = axial_product(translation_, detail::constant<Scalar>(-0.5L),
                                    detail::inverse_jacobian_coefficient<Scalar>(w.squaredNorm()), w);
    Tangent xi;
    set_block(xi, 0, 0, v);
    set_block(xi, 3, 0, w);
    return xi;
  }

  /// X * x.inverse() is the identity.
  [[nodiscard]] SE3 inverse() const {
    const SO3<Scalar> inverse_rotation = rotation_.inverse();
    const Vector3 back = inverse_rotation * translation_;
    return SE3(inverse_rotation, negative(back));
  }

  /// Composition: first `other`, then this.
  [[nodiscard]] SE3 operator*(const SE3& other) const {
    return SE3(rotation_ * other.rotation_, sum_of(rotation_ * other.translation_, translation_));
  }
  SE3& operator*=(const SE3& other) { return *this = *this * other; }  ///< *this = *this * other

  /// The transformed point.
  [[nodiscard]] Vector3 operator*(const Vector3& p) const {
    const Vector3 turned = rotation_ * p;  // one by one in registers: a sum of vectors would wait for it in memory
    return Vector3(turned[0] + translation_[0], turned[1] + translation_[1], turned[2] + translation_[2]);
  }

  /// *this * exp(xi)
  [[nodiscard]] SE3 retract(const Tangent& xi) const { return *this * exp(xi); }
  /// log(inverse() * other): retract(local(other)) is `other`.
  [[nodiscard]] Tangent local(const SE3& other) const { return (inverse() * other).log(); }

  [[nodiscard]] const SO3<Scalar>& rotation() const { return rotation_; }    ///< the rotational part
  [[nodiscard]] const Vector3& translation() const { return translation_; }  ///< the translational part

  /// As a matrix.
  [[nodiscard]] Matrix4 matrix() const {
    Matrix4 T = chainslam::identity<Matrix4>();
    set_block(T, 0, 0, rotation_.matrix());
    set_block(T, 0, 3, translation_);
    return T;
  }

  /// T exp(xi) T^-1 = exp(adjoint() xi)
  [[nodiscard]] Jacobian adjoint() const {
    const Matrix3 R = rotation_.matrix();
    return blocks(R, product(detail::hat3<Scalar>(translation_), R));
  }

  /// exp(xi + d) = exp(left_jacobian(xi) d) * exp(xi) to first order.
  [[nodiscard]] static Jacobian left_jacobian(const Tangent& xi) {
    return blocks(SO3<Scalar>::left_jacobian(angular(xi)), coupling(xi));
  }
  /// Singular where the rotation is 2 pi.
  [[nodiscard]] static Jacobian left_jacobian_inverse(const Tangent& xi) {
    const Matrix3 inverse = SO3<Scalar>::left_jacobian_inverse(angular(xi));
    return blocks(inverse, negative(product(product(inverse, coupling(xi)), inverse)));
  }
  /// exp(xi + d) = exp(xi) * exp(right_jacobian(xi) d) to first order.
  [[nodiscard]] static Jacobian right_jacobian(const Tangent& xi) { return left_jacobian(negative(xi)); }
  /// Singular where the rotation is 2 pi.
  [[nodiscard]] static Jacobian right_jacobian_inverse(const Tangent& xi) {
    return left_jacobian_inverse(negative(xi));
  }

  /// Brings the rotation back to unit length.
  void normalize() { rotation_.normalize(); }

  /// The same with another number type.
  template <class Other>
  [[nodiscard]] SE3<Other> cast() const {
    return SE3<Other>(rotation_.template cast<Other>(), translation_.template cast<Other>());
  }

  /// Whether all members are equal.
  friend bool operator==(const SE3& a, const SE3& b) {
    return a.rotation_ == b.rotation_ && a.translation_ == b.translation_;
  }

 private:
  [[nodiscard]] static Jacobian blocks(const Matrix3& diagonal, const Matrix3& upper) {
    Jacobian matrix;
    set_block(matrix, 0, 0, diagonal);
    set_block(matrix, 0, 3, upper);
    set_block(matrix, 3, 0, zeros<Matrix3>());
    set_block(matrix, 3, 3, diagonal);
    return matrix;
  }

  /// The block Q of the left Jacobian: the derivative of SO(3)'s left Jacobian at w in the direction of v. The same as
  /// Barfoot and Furgale 2014, eq. 102, shortened by hat(w) hat(v) hat(w) = -(w . v) hat(w).
  [[nodiscard]] static Matrix3 coupling(const Tangent& xi) {
    const Vector3 v = linear(xi), w = angular(xi);
    const auto coefficients = detail::jacobian_coefficients<Scalar>(w.squaredNorm());
    const Scalar twice_dot = detail::constant<Scalar>(2) * w.dot(v);
    const Matrix3 V = detail::hat3<Scalar>(v), W_V = detail::hat_product<Scalar>(w, v);
    const Matrix3 slope = detail::axial_matrix<Scalar>(detail::constant<Scalar>(0), twice_dot * coefficients.b_slope,
                                                       twice_dot * coefficients.c_slope, w);
    Matrix3 Q;
#pragma GCC unroll 3
    for (int j = 0; j < 3; ++j)
#pragma GCC unroll 3
      for (int i = 0; i < 3; ++i)
        Q(i, j) = coefficients.b * V(i, j) + coefficients.c * (W_V(i, j) + W_V(j, i)) - slope(i, j);
    return Q;
  }

  [[nodiscard]] static Vector3 linear(const Tangent& xi) { return block_of<3, 1>(xi, 0, 0); }
  [[nodiscard]] static Vector3 angular(const Tangent& xi) { return block_of<3, 1>(xi, 3, 0); }

  /// v + b w x v + c w x (w x v)
  [[nodiscard]] static Vector3 axial_product(const Vector3& v, const Scalar& b, const Scalar& c, const Vector3& w) {
    const Vector3 w_v = w.cross(v);
    const Vector3 first = scaled(b, w_v), second = scaled(c, Vector3(w.cross(w_v)));
    return sum_of(sum_of(v, first), second);
  }

  SO3<Scalar> rotation_;
  Vector3 translation_;
};

using SE3d = SE3<double>;
using SE3f = SE3<float>;
static_assert(LieGroup<SE3d>);
static_assert(sizeof(SE3d) == 7 * sizeof(double) && alignof(SE3d) == alignof(double));

}  // namespace chainslam
