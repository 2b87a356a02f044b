#pragma once

#include "chainslam/lie/detail/similarity_series.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam {

/// Similarities: p_a = s R_a_b p_b + t_a_b, s > 0.
///
/// Tangent [translation; rotation; log of scale], right perturbation (Strasdat 2012, chapter 2). Default: identity.
template <class Scalar_>
class Sim3 {
 public:
  using Scalar = Scalar_;                        ///< float, double or an autodiff number
  static constexpr int dof = 7;                  ///< dimension of the tangent space
  using Tangent = Eigen::Matrix<Scalar, 7, 1>;   ///< element of the tangent space
  using Jacobian = Eigen::Matrix<Scalar, 7, 7>;  ///< derivative of one tangent by another
  using Vector3 = Eigen::Matrix<Scalar, 3, 1>;   ///< 3-vector
  using Matrix3 = Eigen::Matrix<Scalar, 3, 3>;   ///< 3 x 3 matrix
  using Matrix4 = Eigen::Matrix<Scalar, 4, 4>;   ///< 4 x 4 matrix

  Sim3() : translation_(Vector3::Zero()), scale_(detail::constant<Scalar>(1)) {}
  /// @param scale  positive.
  Sim3(const SO3<Scalar>& rotation, const Vector3& translation, const Scalar& scale)
      : rotation_(rotation), translation_(translation), scale_(scale) {}
  /// With scale 1.
  explicit Sim3(const SE3<Scalar>& T) : Sim3(T.rotation(), T.translation(), detail::constant<Scalar>(1)) {}

  [[nodiscard]] static Sim3 identity() { return Sim3(); }  ///< the neutral element

  /// The group element of a tangent; see the class for the order of its coordinates.
  [[nodiscard]] static Sim3 exp(const Tangent& xi) {
    using std::exp;
    const Vector3 w = xi.template segment<3>(3);
    const Vector3 v = xi.template head<3>();
    const auto average = detail::similarity_coefficients<Scalar>(w.squaredNorm(), xi[6]);
    const Vector3 w_v = w.cross(v);
    return Sim3(SO3<Scalar>::exp(w), average.a * v + average.b * w_v + average.c * w.cross(w_v), exp(xi[6]));
  }

  /// Rotation part within pi, see `SO3::log`.
  [[nodiscard]] Tangent log() const {
    using std::log;
    const Vector3 w = rotation_.log();
    const Scalar sigma = log(scale_);
    const Scalar x = w.squaredNorm();
    const auto inverse = detail::similarity_coefficients<Scalar>(x, sigma).inverse(x);
    const Vector3 w_t = w.cross(translation_);
    Tangent xi;
    xi << inverse.a * translation_ + inverse.b * w_t + inverse.c * w.cross(w_t), w, sigma;
    return xi;
  }

  /// X * x.inverse() is the identity.
  [[nodiscard]] Sim3 inverse() const {
    const SO3<Scalar> inverse_rotation = rotation_.inverse();
    const Scalar inverse_scale = detail::constant<Scalar>(1) / scale_;
    return Sim3(inverse_rotation, -inverse_scale * (inverse_rotation * translation_), inverse_scale);
  }

  /// Composition: first `other`, then this.
  [[nodiscard]] Sim3 operator*(const Sim3& other) const {
    return Sim3(rotation_ * other.rotation_, *this * other.translation_, scale_ * other.scale_);
  }
  Sim3& operator*=(const Sim3& other) { return *this = *this * other; }  ///< *this = *this * other

  /// The transformed point.
  [[nodiscard]] Vector3 operator*(const Vector3& p) const { return scale_ * (rotation_ * p) + translation_; }

  /// *this * exp(xi)
  [[nodiscard]] Sim3 retract(const Tangent& xi) const { return *this * exp(xi); }
  /// log(inverse() * other): retract(local(other)) is `other`.
  [[nodiscard]] Tangent local(const Sim3& other) const { return (inverse() * other).log(); }

  [[nodiscard]] const SO3<Scalar>& rotation() const { return rotation_; }    ///< the rotational part
  [[nodiscard]] const Vector3& translation() const { return translation_; }  ///< the translational part
  [[nodiscard]] const Scalar& scale() const { return scale_; }               ///< the scale, positive

  /// Rotation and translation without the scale.
  [[nodiscard]] SE3<Scalar> rigid() const { return SE3<Scalar>(rotation_, translation_); }

  /// [s R, t; 0, 1]
  [[nodiscard]] Matrix4 matrix() const {
    Matrix4 T = Matrix4::Identity();
    T.template topLeftCorner<3, 3>() = scale_ * rotation_.matrix();
    T.template topRightCorner<3, 1>() = translation_;
    return T;
  }

  /// T exp(xi) T^-1 = exp(adjoint() xi)
  [[nodiscard]] Jacobian adjoint() const {
    const Matrix3 R = rotation_.matrix();
    Jacobian matrix = Jacobian::Identity();
    matrix.template topLeftCorner<3, 3>() = scale_ * R;
    matrix.template block<3, 3>(0, 3) = detail::hat3<Scalar>(translation_) * R;
    matrix.template block<3, 1>(0, 6) = -translation_;
    matrix.template block<3, 3>(3, 3) = R;
    return matrix;
  }

  /// exp(xi + d) = exp(left_jacobian(xi) d) * exp(xi) to first order.
  [[nodiscard]] static Jacobian left_jacobian(const Tangent& xi);
  /// Singular where the rotation is 2 pi.
  [[nodiscard]] static Jacobian left_jacobian_inverse(const Tangent& xi);
  /// exp(xi + d) = exp(xi) * exp(right_jacobian(xi) d) to first order.
  [[nodiscard]] static Jacobian right_jacobian(const Tangent& xi) { return left_jacobian(-xi); }
  /// Singular where the rotation is 2 pi.
  [[nodiscard]] static Jacobian right_jacobian_inverse(const Tangent& xi) { return left_jacobian_inverse(-xi); }

  /// Brings the rotation back to unit length.
  void normalize() { rotation_.normalize(); }

  /// The same with another number type.
  template <class Other>
  [[nodiscard]] Sim3<Other> cast() const {
    return Sim3<Other>(rotation_.template cast<Other>(), translation_.template cast<Other>(),
                       static_cast<Other>(scale_));
  }

  /// Whether all members are equal.
  friend bool operator==(const Sim3& a, const Sim3& b) {
    return a.rotation_ == b.rotation_ && a.translation_ == b.translation_ && a.scale_ == b.scale_;
  }

 private:
  [[nodiscard]] static Jacobian bracket(const Tangent& xi);

  SO3<Scalar> rotation_;
  Vector3 translation_;
  Scalar scale_;
};

using Sim3d = Sim3<double>;
using Sim3f = Sim3<float>;

/// The matrix of [xi, .].
template <class Scalar>
auto Sim3<Scalar>::bracket(const Tangent& xi) -> Jacobian {
  const Matrix3 W = detail::hat3<Scalar>(xi.template segment<3>(3));
  Jacobian matrix = Jacobian::Zero();
  matrix.template topLeftCorner<3, 3>() = W;
  matrix.template topLeftCorner<3, 3>().diagonal().array() += xi[6];
  matrix.template block<3, 3>(0, 3) = detail::hat3<Scalar>(xi.template head<3>());
  matrix.template block<3, 1>(0, 6) = -xi.template head<3>();
  matrix.template block<3, 3>(3, 3) = W;
  return matrix;
}

/// The mean of exp(u xi).adjoint() over u in [0, 1]. Its closed form has nine coefficients, each with poles to step
/// around where rotation or scale vanish; halving the tangent until the series sum ad^n / (n + 1)! is short, then J(2
/// xi) = (I + Ad(exp(xi))) J(xi) / 2, is as exact and has none.
template <class Scalar>
auto Sim3<Scalar>::left_jacobian(const Tangent& xi) -> Jacobian {
  using std::abs;
  const Scalar half = detail::constant<Scalar>(0.5L);
  // Translation enters linearly: rotation and scale alone decide. Below 1/2, n / (2^n (n + 1)!) < 1e-20 for n = 16.
  int halvings = 0;
  Tangent small = xi;
  while (halvings < 60 && small.template segment<3>(3).norm() + abs(small[6]) > half) {
    small *= half;
    ++halvings;
  }
  const Jacobian ad = bracket(small);
  Jacobian result = Jacobian::Identity();
  for (int n = 16; n > 0; --n) result = Jacobian::Identity() + ad * result / detail::constant<Scalar>(n + 1);
  for (; halvings > 0; --halvings) {
    const Jacobian Ad = exp(small).adjoint();
    result = half * (result + Ad * result).eval();
    small *= detail::constant<Scalar>(2);
  }
  return result;
}

template <class Scalar>
auto Sim3<Scalar>::left_jacobian_inverse(const Tangent& xi) -> Jacobian {
  const Jacobian jacobian = left_jacobian(xi);
  const Vector3 w = xi.template segment<3>(3);
  const Scalar x = w.squaredNorm();
  const auto average = detail::similarity_coefficients<Scalar>(x, xi[6]).inverse(x);
  const Matrix3 linear = average.a * Matrix3::Identity() + average.b * detail::hat3<Scalar>(w) +
                         average.c * detail::hat_product<Scalar>(w, w);
  const Matrix3 rotation = SO3<Scalar>::left_jacobian_inverse(w);
  Jacobian result = Jacobian::Identity();
  result.template topLeftCorner<3, 3>() = linear;
  result.template block<3, 3>(0, 3) = -linear * jacobian.template block<3, 3>(0, 3) * rotation;
  result.template block<3, 1>(0, 6) = -linear * jacobian.template block<3, 1>(0, 6);
  result.template block<3, 3>(3, 3) = rotation;
  return result;
}

static_assert(LieGroup<Sim3d>);

}  // namespace chainslam
