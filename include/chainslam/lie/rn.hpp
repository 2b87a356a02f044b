#pragma once

#include <Eigen/Core>

#include "chainslam/lie/concepts.hpp"

namespace chainslam {

/// Vectors of R^N under addition: the group of biases, velocities and positions. Default: zero.
template <class Scalar_, int N>
class Rn {
  static_assert(N > 0, "Rn: the dimension N must be known at compile time and positive");

 public:
  using Scalar = Scalar_;
  static constexpr int dof = N;
  using Tangent = Eigen::Matrix<Scalar, N, 1>;
  using Jacobian = Eigen::Matrix<Scalar, N, N>;

  Rn() : value_(Tangent::Zero()) {}
  explicit Rn(const Tangent& value) : value_(value) {}

  [[nodiscard]] static Rn identity() { return Rn(); }
  [[nodiscard]] static Rn exp(const Tangent& v) { return Rn(v); }
  [[nodiscard]] Tangent log() const { return value_; }
  [[nodiscard]] Rn inverse() const { return Rn(-value_); }
  [[nodiscard]] Rn operator*(const Rn& other) const { return Rn(value_ + other.value_); }
  Rn& operator*=(const Rn& other) { return *this = *this * other; }

  /// value() + v
  [[nodiscard]] Rn retract(const Tangent& v) const { return Rn(value_ + v); }
  /// other.value() - value()
  [[nodiscard]] Tangent local(const Rn& other) const { return other.value_ - value_; }

  [[nodiscard]] Tangent value() const { return value_; }

  [[nodiscard]] Jacobian adjoint() const { return Jacobian::Identity(); }
  [[nodiscard]] static Jacobian left_jacobian(const Tangent&) { return Jacobian::Identity(); }
  [[nodiscard]] static Jacobian left_jacobian_inverse(const Tangent&) { return Jacobian::Identity(); }
  [[nodiscard]] static Jacobian right_jacobian(const Tangent&) { return Jacobian::Identity(); }
  [[nodiscard]] static Jacobian right_jacobian_inverse(const Tangent&) { return Jacobian::Identity(); }

  template <class Other>
  [[nodiscard]] Rn<Other, N> cast() const {
    return Rn<Other, N>(value().template cast<Other>());
  }

  friend bool operator==(const Rn& a, const Rn& b) { return a.value_ == b.value_; }

 private:
  Eigen::Matrix<Scalar, N, 1, Eigen::DontAlign> value_;
};

using R1d = Rn<double, 1>;
using R2d = Rn<double, 2>;
using R3d = Rn<double, 3>;
static_assert(LieGroup<R3d>);

}  // namespace chainslam
