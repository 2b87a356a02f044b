#pragma once

#include <Eigen/Core>
#include <cmath>

namespace chainslam::test {

/// A number with its derivative by one parameter: a user's scalar, written without a thought of this library.
struct Dual {
  double value = 0;
  double derivative = 0;

  Dual() = default;
  Dual(double v) : value(v) {}  // NOLINT: numbers are constants
  Dual(double v, double d) : value(v), derivative(d) {}

  Dual operator-() const { return {-value, -derivative}; }
  Dual& operator+=(const Dual& o) { return *this = *this + o; }
  Dual& operator-=(const Dual& o) { return *this = *this - o; }
  Dual& operator*=(const Dual& o) { return *this = *this * o; }
  Dual& operator/=(const Dual& o) { return *this = *this / o; }

  friend Dual operator+(const Dual& a, const Dual& b) { return {a.value + b.value, a.derivative + b.derivative}; }
  friend Dual operator-(const Dual& a, const Dual& b) { return {a.value - b.value, a.derivative - b.derivative}; }
  friend Dual operator*(const Dual& a, const Dual& b) {
    return {a.value * b.value, a.derivative * b.value + a.value * b.derivative};
  }
  friend Dual operator/(const Dual& a, const Dual& b) {
    return {a.value / b.value, (a.derivative * b.value - a.value * b.derivative) / (b.value * b.value)};
  }
  friend bool operator<(const Dual& a, const Dual& b) { return a.value < b.value; }
  friend bool operator>(const Dual& a, const Dual& b) { return a.value > b.value; }
  friend bool operator==(const Dual& a, const Dual& b) { return a.value == b.value; }
};

inline Dual sqrt(const Dual& x) {
  const double root = std::sqrt(x.value);
  return {root, x.derivative / (2 * root)};
}
inline Dual sin(const Dual& x) { return {std::sin(x.value), std::cos(x.value) * x.derivative}; }
inline Dual cos(const Dual& x) { return {std::cos(x.value), -std::sin(x.value) * x.derivative}; }
inline Dual tan(const Dual& x) {
  const double t = std::tan(x.value);
  return {t, (1 + t * t) * x.derivative};
}
inline Dual atan2(const Dual& y, const Dual& x) {
  const double squared = x.value * x.value + y.value * y.value;
  return {std::atan2(y.value, x.value), (x.value * y.derivative - y.value * x.derivative) / squared};
}
inline Dual abs(const Dual& x) { return x.value < 0 ? -x : x; }

}  // namespace chainslam::test

template <>
struct Eigen::NumTraits<chainslam::test::Dual> : Eigen::NumTraits<double> {
  using Real = chainslam::test::Dual;
  using NonInteger = chainslam::test::Dual;
  using Nested = chainslam::test::Dual;
  enum {
    IsComplex = 0,
    IsInteger = 0,
    IsSigned = 1,
    RequireInitialization = 1,
    ReadCost = 2,
    AddCost = 2,
    MulCost = 6
  };
};
