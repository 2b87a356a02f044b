#pragma once

#include <cstring>

namespace chainslam::detail {

/// Four doubles that are worked on together, one pair of points in each. Where formulas are templates on their number
/// type, this is one.
struct Quad {
  static constexpr int size = 4;
  typedef double Values __attribute__((vector_size(size * sizeof(double))));
  Values values;

  Quad() = default;
  Quad(double value) : values(value - Values{}) {}  // NOLINT(google-explicit-constructor): constants in formulas
  explicit Quad(const Values& v) : values(v) {}

  [[nodiscard]] static Quad load(const double* from) {
    Quad quad;
    std::memcpy(&quad.values, from, sizeof(Values));
    return quad;
  }
  [[nodiscard]] static Quad load(const float* from) {
    typedef float Floats __attribute__((vector_size(size * sizeof(float))));
    Floats floats;
    std::memcpy(&floats, from, sizeof(Floats));
    return Quad(__builtin_convertvector(floats, Values));
  }
  void store(double* to) const { std::memcpy(to, &values, sizeof(Values)); }

  [[nodiscard]] double operator[](int lane) const { return values[lane]; }
  void set(int lane, double value) { values[lane] = value; }
  [[nodiscard]] double sum() const { return (values[0] + values[1]) + (values[2] + values[3]); }

  friend Quad operator+(const Quad& a, const Quad& b) { return Quad(a.values + b.values); }
  friend Quad operator-(const Quad& a, const Quad& b) { return Quad(a.values - b.values); }
  friend Quad operator*(const Quad& a, const Quad& b) { return Quad(a.values * b.values); }
  friend Quad operator/(const Quad& a, const Quad& b) { return Quad(a.values / b.values); }
  Quad& operator+=(const Quad& other) {
    values += other.values;
    return *this;
  }

  /// `value` in the lanes where a <= b, `other` in the rest.
  [[nodiscard]] static Quad where_at_most(const Quad& a, const Quad& b, const Quad& value, const Quad& other) {
    return Quad(a.values <= b.values ? value.values : other.values);
  }
};

}  // namespace chainslam::detail
