#pragma once

#include <Eigen/Core>
#include <cmath>
#include <numbers>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/lie/concepts.hpp"
#include "chainslam/lie/so3.hpp"

namespace chainslam {

/// Directions in space: the unit sphere, a manifold but no group. Holds the direction of gravity.
///
/// Tangent: two coordinates along `basis()`, radians of arc; `retract` walks the great circle. Default: +z.
template <class Scalar_>
class S2 {
 public:
  using Scalar = Scalar_;                       ///< float, double or an autodiff number
  static constexpr int dof = 2;                 ///< dimension of the tangent space
  using Tangent = Eigen::Matrix<Scalar, 2, 1>;  ///< element of the tangent space
  using Vector3 = Eigen::Matrix<Scalar, 3, 1>;  ///< 3-vector
  using Basis = Eigen::Matrix<Scalar, 3, 2>;    ///< 3 x 2

  S2() : direction_(Vector3::UnitZ()) {}

  /// @param v  any vector but zero; its length is dropped.
  [[nodiscard]] static S2 from_vector(const Vector3& v) { return S2(v / v.norm()); }

  /// Unit length.
  [[nodiscard]] const Vector3& direction() const { return direction_; }

  /// Orthonormal columns that span the tangent plane: d direction() / d tangent at 0 (Duff et al. 2017).
  [[nodiscard]] Basis basis() const {
    const Scalar one = detail::constant<Scalar>(1);
    const Scalar sign = direction_[2] < detail::constant<Scalar>(0) ? Scalar(-one) : one;
    const Scalar a = -one / (sign + direction_[2]);
    const Scalar b = direction_[0] * direction_[1] * a;
    Basis basis;
    basis(0, 0) = one + sign * direction_[0] * direction_[0] * a;
    basis(1, 0) = sign * b;
    basis(2, 0) = -sign * direction_[0];
    basis(0, 1) = b;
    basis(1, 1) = sign + direction_[1] * direction_[1] * a;
    basis(2, 1) = -direction_[1];
    return basis;
  }

  /// The point |d| radians along the great circle that starts towards basis() * d.
  [[nodiscard]] S2 retract(const Tangent& d) const {
    const Scalar x = d.squaredNorm();
    const Vector3 along = product(basis(), d);
    const Vector3 kept = detail::cosine(x) * direction_, way = detail::sinc(x) * along;
    return from_vector(kept + way);
  }

  /// The tangent with retract(local(other)) = other, |d| <= pi. For the opposite point, which every direction reaches,
  /// the first basis vector is taken.
  [[nodiscard]] Tangent local(const S2& other) const {
    using std::atan2, std::sqrt;
    const Tangent sine = transposed_product(basis(), other.direction_);
    const Scalar cosine = direction_.dot(other.direction_);
    const Scalar squared = sine.squaredNorm();
    if (cosine > detail::constant<Scalar>(0))
      return chainslam::scaled(detail::atan_over_argument<Scalar>(squared, cosine), sine);
    if (!(squared > detail::constant<Scalar>(0)))
      return Tangent(detail::constant<Scalar>(std::numbers::pi_v<long double>), detail::constant<Scalar>(0));
    const Scalar length = sqrt(squared);
    return chainslam::scaled(atan2(length, cosine) / length, sine);
  }

  /// d retract(d).local(retract(d + e)) / d e at e = 0: see `lie/jacobians.hpp`.
  [[nodiscard]] Eigen::Matrix<Scalar, 2, 2> retract_jacobian(const Tangent& d) const {
    const Scalar x = d.squaredNorm();
    const auto [b, c, b_slope, c_slope] = detail::jacobian_coefficients<Scalar>(x);
    const Scalar sinc = detail::sinc(x);
    const Basis from = basis(), to = retract(d).basis();
    const Vector3 along = product(from, d);
    const Vector3 bent = (c - b) * along, kept = sinc * direction_;
    const Vector3 arc = bent - kept;
    Basis moved;
    for (int j = 0; j < 2; ++j)
      for (int i = 0; i < 3; ++i) moved(i, j) = sinc * from(i, j) + arc[i] * d[j];
    return transposed_product(to, moved);
  }

  /// The direction turned by R.
  [[nodiscard]] friend S2 operator*(const SO3<Scalar>& R, const S2& direction) {
    return from_vector(R * direction.direction_);
  }

  /// The same with another number type.
  template <class Other>
  [[nodiscard]] S2<Other> cast() const {
    return S2<Other>::from_vector(direction_.template cast<Other>());
  }

  /// Whether all members are equal.
  friend bool operator==(const S2& a, const S2& b) { return a.direction_ == b.direction_; }

 private:
  explicit S2(const Vector3& unit) : direction_(unit) {}

  Vector3 direction_;
};

using S2d = S2<double>;
using S2f = S2<float>;
static_assert(Manifold<S2d> && !LieGroup<S2d>);

}  // namespace chainslam
