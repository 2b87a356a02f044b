#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>
#include <limits>
#include <type_traits>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/lie/concepts.hpp"
#include "chainslam/lie/detail/rotation_series.hpp"

namespace chainslam {

/// Rotations of space: unit quaternions, q and -q the same rotation.
///
/// Tangent: rotation vector, radians; right perturbation R * exp(w) (Sola et al. 2018). Exact at 0 and at pi in the
/// scalar's own precision. Every product is brought back to unit length, so that |R'R - I| stays at rounding however
/// long the chain. Default: identity. Four scalars, no alignment that depends on compiler flags.
template <class Scalar_>
class SO3 {
 public:
  using Scalar = Scalar_;                                          ///< float, double or an autodiff number
  static constexpr int dof = 3;                                    ///< dimension of the tangent space
  using Tangent = Eigen::Matrix<Scalar, 3, 1>;                     ///< element of the tangent space
  using Jacobian = Eigen::Matrix<Scalar, 3, 3>;                    ///< derivative of one tangent by another
  using Vector3 = Eigen::Matrix<Scalar, 3, 1>;                     ///< 3-vector
  using Matrix3 = Eigen::Matrix<Scalar, 3, 3>;                     ///< 3 x 3 matrix
  using Quaternion = Eigen::Quaternion<Scalar, Eigen::DontAlign>;  ///< quaternion type

  SO3() : quaternion_(Scalar(1), Scalar(0), Scalar(0), Scalar(0)) {}
  SO3(const SO3&) = default;  ///< copies
  SO3(SO3&&) = default;       ///< copies
  /// Copies.
  SO3& operator=(const SO3& other) noexcept {  // number by number, which compiles faster than Eigen's assignment
    for (int i = 0; i < 4; ++i) quaternion_.coeffs().data()[i] = other.quaternion_.coeffs().data()[i];
    return *this;
  }

  [[nodiscard]] static SO3 identity() { return SO3(); }  ///< the neutral element

  /// From any quaternion but zero. One that has unit length up to rounding is kept bit for bit, so that what was
  /// written to a file comes back the same.
  template <class Derived>
  [[nodiscard]] static SO3 from_quaternion(const Eigen::QuaternionBase<Derived>& q) {
    SO3 result{Quaternion(q)};
    result.normalize();
    return result;
  }

  /// From a matrix near a rotation, through the largest of the quaternion's four components (Shepperd 1978): no loss of
  /// digits at any angle. Exact for rotations; a matrix off by e gives a rotation within O(e).
  [[nodiscard]] static SO3 from_matrix(const Matrix3& R);

  /// The least rotation that turns the direction of `from` into that of `to`; a half rotation about some axis across
  /// them where they are opposite. Neither may be zero.
  [[nodiscard]] static SO3 between(const Vector3& from, const Vector3& to) {
    const Vector3 a = from / from.norm(), b = to / to.norm();
    const Vector3 half_way = a + b;
    if (!(half_way.squaredNorm() > std::numeric_limits<Scalar>::epsilon())) {
      const Vector3 across = most_across(a);
      return from_quaternion(Quaternion(Scalar(0), across.x(), across.y(), across.z()));
    }
    const Vector3 h = half_way / half_way.norm();
    const Vector3 axis = a.cross(h);
    return from_quaternion(Quaternion(a.dot(h), axis.x(), axis.y(), axis.z()));
  }

  /// Turns by |w| about w.
  [[nodiscard]] static SO3 exp(const Tangent& w) {
    const Scalar quarter = w.squaredNorm() * detail::constant<Scalar>(0.25L);
    const Scalar scale = detail::sinc(quarter) * detail::constant<Scalar>(0.5L);
    return SO3(Quaternion(detail::cosine(quarter), scale * w[0], scale * w[1], scale * w[2]));
  }

  /// The rotation vector, |w| <= pi. At pi either sign is right; the same quaternion always gives the same one.
  /// 2 atan2(|v|, w) holds its digits everywhere (Hertzberg et al. 2013).
  [[nodiscard]] Tangent log() const {
    const Scalar& w = quaternion_.w();
    const bool flip = w < detail::constant<Scalar>(0);
    const Scalar abs_w = flip ? Scalar(-w) : w;
    const Scalar scale =
        detail::constant<Scalar>(2) * detail::atan_over_argument<Scalar>(vector().squaredNorm(), abs_w);
    return (flip ? Scalar(-scale) : scale) * vector();
  }

  /// X * x.inverse() is the identity.
  [[nodiscard]] SO3 inverse() const {
    return SO3(Quaternion(quaternion_.w(), -quaternion_.x(), -quaternion_.y(), -quaternion_.z()));
  }

  /// Composition: first `other`, then this.
  [[nodiscard]] SO3 operator*(const SO3& other) const {
    const Quaternion &a = quaternion_, &b = other.quaternion_;
    const Scalar w = a.w() * b.w() - a.x() * b.x() - a.y() * b.y() - a.z() * b.z();
    const Scalar x = a.w() * b.x() + a.x() * b.w() + a.y() * b.z() - a.z() * b.y();
    const Scalar y = a.w() * b.y() + a.y() * b.w() + a.z() * b.x() - a.x() * b.z();
    const Scalar z = a.w() * b.z() + a.z() * b.w() + a.x() * b.y() - a.y() * b.x();
    // One Newton step towards length 1: exact to rounding, as both factors are.
    const Scalar squared = x * x + y * y + z * z + w * w;
    const Scalar scale = detail::constant<Scalar>(1.5L) - squared * detail::constant<Scalar>(0.5L);
    return SO3(Quaternion(scale * w, scale * x, scale * y, scale * z));
  }
  SO3& operator*=(const SO3& other) { return *this = *this * other; }  ///< *this = *this * other

  /// The rotated vector.
  [[nodiscard]] Vector3 operator*(const Vector3& p) const {
    const Scalar w = quaternion_.w(), x = quaternion_.x(), y = quaternion_.y(), z = quaternion_.z();
    const Scalar half_a = y * p[2] - z * p[1], half_b = z * p[0] - x * p[2], half_c = x * p[1] - y * p[0];
    const Scalar a = half_a + half_a, b = half_b + half_b, c = half_c + half_c;
    return Vector3(p[0] + w * a + (y * c - z * b), p[1] + w * b + (z * a - x * c), p[2] + w * c + (x * b - y * a));
  }

  /// *this * exp(w)
  [[nodiscard]] SO3 retract(const Tangent& w) const { return *this * exp(w); }
  /// log(inverse() * other): retract(local(other)) is `other`.
  [[nodiscard]] Tangent local(const SO3& other) const { return (inverse() * other).log(); }

  [[nodiscard]] Matrix3 matrix() const { return quaternion_.toRotationMatrix(); }  ///< as a matrix
  [[nodiscard]] const Quaternion& quaternion() const { return quaternion_; }       ///< as a unit quaternion

  /// R exp(w) R^-1 = exp(adjoint() w)
  [[nodiscard]] Jacobian adjoint() const { return matrix(); }

  /// The matrix of w x (.).
  [[nodiscard]] static Matrix3 hat(const Tangent& w) { return detail::hat3<Scalar>(w); }

  /// d exp: exp(w + d) = exp(left_jacobian(w) d) * exp(w) to first order.
  [[nodiscard]] static Jacobian left_jacobian(const Tangent& w) {
    const auto coefficients = detail::jacobian_coefficients<Scalar>(w.squaredNorm());
    return detail::axial_matrix<Scalar>(detail::constant<Scalar>(1), coefficients.b, coefficients.c, w);
  }
  /// Singular at |w| = 2 pi.
  [[nodiscard]] static Jacobian left_jacobian_inverse(const Tangent& w) {
    return detail::axial_matrix<Scalar>(detail::constant<Scalar>(1), detail::constant<Scalar>(-0.5L),
                                        detail::inverse_jacobian_coefficient<Scalar>(w.squaredNorm()), w);
  }
  /// exp(w + d) = exp(w) * exp(right_jacobian(w) d) to first order.
  [[nodiscard]] static Jacobian right_jacobian(const Tangent& w) { return left_jacobian(negative(w)); }
  /// Singular at |w| = 2 pi.
  [[nodiscard]] static Jacobian right_jacobian_inverse(const Tangent& w) { return left_jacobian_inverse(negative(w)); }

  /// Brings the quaternion back to unit length.
  void normalize() {
    using std::abs, std::sqrt;
    const auto& q = quaternion_;
    const Scalar squared = (q.x() * q.x() + q.z() * q.z()) + (q.y() * q.y() + q.w() * q.w());
    const Scalar rounding = detail::constant<Scalar>(8 * static_cast<long double>(epsilon()));
    if (!(abs(squared - detail::constant<Scalar>(1)) > rounding)) return;
    const Scalar length = sqrt(squared);
    for (int i = 0; i < 4; ++i) quaternion_.coeffs()[i] /= length;
  }

  /// The same with another number type.
  template <class Other>
  [[nodiscard]] SO3<Other> cast() const {
    return SO3<Other>::from_quaternion(quaternion_.template cast<Other>());
  }

  /// Whether all members are equal.
  friend bool operator==(const SO3& a, const SO3& b) {
    const Quaternion &p = a.quaternion_, &q = b.quaternion_;
    return p.w() == q.w() && p.x() == q.x() && p.y() == q.y() && p.z() == q.z();
  }

 private:
  explicit SO3(const Quaternion& unit) : quaternion_(unit) {}

  [[nodiscard]] Vector3 vector() const { return Vector3(quaternion_.x(), quaternion_.y(), quaternion_.z()); }

  /// A unit vector across a, and across the coordinate axis that is farthest from a.
  [[nodiscard]] static Vector3 most_across(const Vector3& a) {
    using std::abs;
    int least = 0;
    for (int i = 1; i < 3; ++i)
      if (abs(a[i]) < abs(a[least])) least = i;
    Vector3 axis = Vector3::Zero();
    axis[least] = detail::constant<Scalar>(1);
    const Vector3 across = a.cross(axis);
    return across / across.norm();
  }

  static constexpr auto epsilon() {
    if constexpr (std::is_floating_point_v<Scalar>)
      return std::numeric_limits<Scalar>::epsilon();
    else
      return std::numeric_limits<double>::epsilon();
  }

  Quaternion quaternion_;
};

using SO3d = SO3<double>;
using SO3f = SO3<float>;
static_assert(sizeof(SO3d) == 4 * sizeof(double) && alignof(SO3d) == alignof(double));

template <class Scalar>
SO3<Scalar> SO3<Scalar>::from_matrix(const Matrix3& R) {
  const Scalar one = detail::constant<Scalar>(1);
  Eigen::Matrix<Scalar, 4, 1> q;  // x, y, z, w, each times the largest of them
  const Scalar trace = R(0, 0) + R(1, 1) + R(2, 2);
  int pivot = 0;
  for (int i = 1; i < 3; ++i)
    if (R(i, i) > R(pivot, pivot)) pivot = i;
  if (trace > R(pivot, pivot)) {
    q[0] = R(2, 1) - R(1, 2);
    q[1] = R(0, 2) - R(2, 0);
    q[2] = R(1, 0) - R(0, 1);
    q[3] = one + trace;
  } else {
    const int next = (pivot + 1) % 3;
    const int last = (pivot + 2) % 3;
    q[pivot] = one + R(pivot, pivot) - R(next, next) - R(last, last);
    q[next] = R(next, pivot) + R(pivot, next);
    q[last] = R(last, pivot) + R(pivot, last);
    q[3] = R(last, next) - R(next, last);
  }
  return from_quaternion(Quaternion(q[3], q[0], q[1], q[2]));
}

static_assert(LieGroup<SO3d>);

}  // namespace chainslam
