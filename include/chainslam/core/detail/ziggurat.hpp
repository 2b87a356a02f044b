#pragma once

#include <array>
#include <cstddef>

namespace chainslam::detail {

/// exp, log and sqrt for constant expressions. A compiler folds each operation by itself and rounds it as IEEE 754
/// says, so that tables made here have the same bits under every compiler, flag and C library. Good to a few units of
/// the last place over the ziggurat's range.
constexpr double constant_exp(double x) {
  constexpr int halvings = 6;
  const double reduced = x / (1 << halvings);
  double term = 1.0;
  double sum = 1.0;
  for (int n = 1; n < 20; ++n) sum += term *= reduced / n;
  for (int i = 0; i < halvings; ++i) sum *= sum;
  return sum;
}

constexpr double constant_log(double x) {  // by Newton's method on exp(y) = x, for x in (0, 1]
  double y = x - 1.0;
  for (int i = 0; i < 60; ++i) y += x / constant_exp(y) - 1.0;
  return y;
}

constexpr double constant_sqrt(double x) {
  double root = x > 1.0 ? x : 1.0;
  for (int i = 0; i < 60; ++i) root = 0.5 * (root + x / root);
  return root;
}

/// The right half of the normal density exp(-x^2 / 2), cut into layers of equal area (Marsaglia and Tsang 2000, section
/// 2).
struct Ziggurat {
  static constexpr std::size_t layers = 128;
  static constexpr double tail_start = 3.442619855899;  ///< Marsaglia and Tsang 2000, for 128 layers
  static constexpr double layer_area = 9.91256303526217e-3;

  std::array<double, layers + 1> edges{};      ///< right edge of layer i; edges[0] is the base's, had it no tail
  std::array<double, layers + 1> densities{};  ///< exp(-edges[i]^2 / 2)

  constexpr Ziggurat() {
    const double density_at_tail = constant_exp(-0.5 * tail_start * tail_start);
    edges[0] = layer_area / density_at_tail;
    densities[0] = 0.0;
    edges[1] = tail_start;
    densities[1] = density_at_tail;
    for (std::size_t i = 2; i < layers; ++i) {
      densities[i] = densities[i - 1] + layer_area / edges[i - 1];
      edges[i] = constant_sqrt(-2.0 * constant_log(densities[i]));
    }
    edges[layers] = 0.0;
    densities[layers] = 1.0;
  }
};

inline constexpr Ziggurat ziggurat;

}  // namespace chainslam::detail
