#include "chainslam/core/detail/ziggurat.hpp"

#include <doctest/doctest.h>

#include <array>
#include <cstddef>

namespace chainslam::detail {
namespace {

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

/// Marsaglia and Tsang 2000, section 2: each layer has the area of the base, the tail included.
struct Recursion {
  std::array<double, Ziggurat::layers + 1> edges{}, densities{};

  constexpr Recursion() {
    constexpr double start = Ziggurat::tail_start;
    densities[1] = constant_exp(-0.5 * start * start);
    edges[1] = start;
    edges[0] = Ziggurat::layer_area / densities[1];
    for (std::size_t i = 2; i < Ziggurat::layers; ++i) {
      densities[i] = densities[i - 1] + Ziggurat::layer_area / edges[i - 1];
      edges[i] = constant_sqrt(-2.0 * constant_log(densities[i]));
    }
    densities[Ziggurat::layers] = 1.0;
  }
};

TEST_SUITE("core/ziggurat") {
  TEST_CASE("the table holds the recursion's numbers, bit for bit") {
    static constexpr Recursion computed;
    static_assert(computed.edges == Ziggurat::edges && computed.densities == Ziggurat::densities);
    CHECK(Ziggurat::edges.front() > Ziggurat::edges[1]);
  }
}

}  // namespace
}  // namespace chainslam::detail
