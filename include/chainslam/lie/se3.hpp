#pragma once

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
  using Scalar = Scalar_;
  static constexpr int dof = 6;
  using Tangent = Eigen::Matrix<Scalar, 6, 1>;
  using Jacobian = Eigen::Matrix<Scalar, 6, 6>;
  using Vector3 = Eigen::Matrix<Scalar, 3, 1>;
  using Matrix3 = Eigen::Matrix<Scalar, 3, 3>;
  using Matrix4 = Eigen::Matrix<Scalar, 4, 4>;

  SE3() : translation_(Vector3::Zero()) {}
  SE3(const SO3<Scalar>& rotation, const Vector3& translation) : rotation_(rotation), translation_(translation) {}

  [[nodiscard]] static SE3 identity() { return SE3(); }

  /// From the homogeneous matrix [R t; 0 1]; R as in `SO3::from_matrix`, the last row is not looked at.
  [[nodiscard]] static SE3 from_matrix(const Matrix4& T) {
    return SE3(SO3<Scalar>::from_matrix(T.template topLeftCorner<3, 3>()), T.template topRightCorner<3, 1>());
  }

  [[nodiscard]] static SE3 exp(const Tangent& xi) {
    const Vector3 w = xi.template tail<3>();
    const Vector3 v = xi.template head<3>();
    const auto coefficients = detail::jacobian_coefficients<Scalar>(w.squaredNorm());
    const Vector3 w_v = w.cross(v);
    return SE3(SO3<Scalar>::exp(w), v + coefficients.b * w_v + coefficients.c * w.cross(w_v));
  }

  /// Rotation part within pi, see `SO3::log`.
  [[nodiscard]] Tangent log() const {
    const Vector3 w = rotation_.log();
    const Vector3 w_t = w.cross(translation_);
    Tangent xi;
    xi << translation_ - detail::constant<Scalar>(0.5L) * w_t +
              detail::inverse_jacobian_coefficient<Scalar>(w.squaredNorm()) * w.cross(w_t),
        w;
    return xi;
  }

  [[nodiscard]] SE3 inverse() const {
    const SO3<Scalar> inverse_rotation = rotation_.inverse();
    return SE3(inverse_rotation, -(inverse_rotation * translation_));
  }

  [[nodiscard]] SE3 operator*(const SE3& other) const {
    return SE3(rotation_ * other.rotation_, rotation_ * other.translation_ + translation_);
  }
  SE3& operator*=(const SE3& other) { return *this = *this * other; }

  [[nodiscard]] Vector3 operator*(const Vector3& p) const { return rotation_ * p + translation_; }

  /// *this * exp(xi)
  [[nodiscard]] SE3 retract(const Tangent& xi) const { return *this * exp(xi); }
  /// log(inverse() * other): retract(local(other)) is `other`.
  [[nodiscard]] Tangent local(const SE3& other) const { return (inverse() * other).log(); }

  [[nodiscard]] const SO3<Scalar>& rotation() const { return rotation_; }
  [[nodiscard]] const Vector3& translation() const { return translation_; }

  [[nodiscard]] Matrix4 matrix() const {
    Matrix4 T = Matrix4::Identity();
    T.template topLeftCorner<3, 3>() = rotation_.matrix();
    T.template topRightCorner<3, 1>() = translation_;
    return T;
  }

  /// T exp(xi) T^-1 = exp(adjoint() xi)
  [[nodiscard]] Jacobian adjoint() const {
    const Matrix3 R = rotation_.matrix();
    return blocks(R, detail::hat3<Scalar>(translation_) * R);
  }

  /// exp(xi + d) = exp(left_jacobian(xi) d) * exp(xi) to first order.
  [[nodiscard]] static Jacobian left_jacobian(const Tangent& xi) {
    return blocks(SO3<Scalar>::left_jacobian(xi.template tail<3>()), coupling(xi));
  }
  /// Singular where the rotation is 2 pi.
  [[nodiscard]] static Jacobian left_jacobian_inverse(const Tangent& xi) {
    const Matrix3 inverse = SO3<Scalar>::left_jacobian_inverse(xi.template tail<3>());
    return blocks(inverse, -inverse * coupling(xi) * inverse);
  }
  /// exp(xi + d) = exp(xi) * exp(right_jacobian(xi) d) to first order.
  [[nodiscard]] static Jacobian right_jacobian(const Tangent& xi) { return left_jacobian(-xi); }
  /// Singular where the rotation is 2 pi.
  [[nodiscard]] static Jacobian right_jacobian_inverse(const Tangent& xi) { return left_jacobian_inverse(-xi); }

  /// Brings the rotation back to unit length.
  void normalize() { rotation_.normalize(); }

  template <class Other>
  [[nodiscard]] SE3<Other> cast() const {
    return SE3<Other>(rotation_.template cast<Other>(), translation_.template cast<Other>());
  }

  friend bool operator==(const SE3& a, const SE3& b) {
    return a.rotation_ == b.rotation_ && a.translation_ == b.translation_;
  }

 private:
  [[nodiscard]] static Jacobian blocks(const Matrix3& diagonal, const Matrix3& upper) {
    Jacobian matrix;
    matrix << diagonal, upper, Matrix3::Zero(), diagonal;
    return matrix;
  }

  /// The block Q of the left Jacobian: the derivative of SO(3)'s left Jacobian at w in the direction of v. The same as
  /// Barfoot and Furgale 2014, eq. 102, shortened by hat(w) hat(v) hat(w) = -(w . v) hat(w).
  [[nodiscard]] static Matrix3 coupling(const Tangent& xi) {
    const Vector3 v = xi.template head<3>();
    const Vector3 w = xi.template tail<3>();
    const auto coefficients = detail::jacobian_coefficients<Scalar>(w.squaredNorm());
    const Scalar twice_dot = detail::constant<Scalar>(2) * w.dot(v);
    return coefficients.b * detail::hat3<Scalar>(v) +
           coefficients.c * (detail::hat_product<Scalar>(w, v) + detail::hat_product<Scalar>(v, w)) -
           twice_dot * (coefficients.b_slope * detail::hat3<Scalar>(w) +
                        coefficients.c_slope * detail::hat_product<Scalar>(w, w));
  }

  SO3<Scalar> rotation_;
  Vector3 translation_;
};

using SE3d = SE3<double>;
using SE3f = SE3<float>;
static_assert(LieGroup<SE3d>);
static_assert(sizeof(SE3d) == 7 * sizeof(double) && alignof(SE3d) == alignof(double));

}  // namespace chainslam
