#include "chainslam/core/robust_kernels.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <limits>

#include "support/property.hpp"

namespace chainslam {
namespace {

struct WeightOfWrongType {
  float weight(double) const { return 1.0F; }
};
struct WithoutWeight {
  double cost(double) const { return 0.0; }
};
static_assert(!RobustKernel<WeightOfWrongType> && !RobustKernel<WithoutWeight>);

template <class Kernel>
Kernel kernel_of_width(double width) {
  if constexpr (requires(Kernel kernel) { kernel.width; })
    return Kernel{.width = width};
  else
    return Kernel{};
}

TEST_SUITE("core/robust_kernels") {
  TEST_CASE_TEMPLATE("weight is the derivative of cost", Kernel, Trivial, Huber, Cauchy, GemanMcClure, Tukey) {
    test::for_all(200, [](Rng& rng, int) {
      const double width = std::exp(rng.uniform(-3.0, 3.0));
      const auto kernel = kernel_of_width<Kernel>(width);
      const double s = width * width * std::exp(rng.uniform(-6.0, 4.0));
      const double step = 1e-5 * s;
      const double numeric = (kernel.cost(s + step) - kernel.cost(s - step)) / (2.0 * step);
      // Truncation: step^2 rho''' / 6 ~ 1e-11; rounding: 1e-16 rho / step ~ 1e-11 rho / s, and rho <= s. At the kink of
      // Huber and Tukey the second derivative jumps: an error of step times the jump, <= 1e-5.
      CHECK(kernel.weight(s) == doctest::Approx(numeric).epsilon(2e-5));
    });
  }

  TEST_CASE_TEMPLATE("a kernel is least squares near zero", Kernel, Trivial, Huber, Cauchy, GemanMcClure, Tukey) {
    const auto kernel = kernel_of_width<Kernel>(0.5);
    CHECK(kernel.weight(0.0) == 1.0);
    CHECK(kernel.cost(0.0) == 0.0);
    CHECK(kernel.cost(1e-8) == doctest::Approx(1e-8).epsilon(1e-6));
  }

  TEST_CASE_TEMPLATE("weights lie in [0, 1] and never grow, costs never fall", Kernel, Trivial, Huber, Cauchy,
                     GemanMcClure, Tukey) {
    const auto kernel = kernel_of_width<Kernel>(0.5);
    double weight = 1.0, cost = 0.0;
    for (double s = 1e-6; s < 1e12; s *= 1.1) {
      CHECK(kernel.weight(s) >= 0.0);
      CHECK(kernel.weight(s) <= weight);
      CHECK(kernel.cost(s) >= cost);
      weight = kernel.weight(s);
      cost = kernel.cost(s);
    }
  }

  TEST_CASE_TEMPLATE("an infinite residual has no weight", Kernel, Huber, Cauchy, GemanMcClure, Tukey) {
    CHECK(kernel_of_width<Kernel>(2.0).weight(std::numeric_limits<double>::infinity()) == 0.0);
  }

  TEST_CASE("weights at the width are those of Zhang 1997, table 1") {
    const double width = 1.7, s = width * width;
    CHECK(Huber{width}.weight(s) == 1.0);
    CHECK(Huber{width}.weight(4.0 * s) == doctest::Approx(0.5));
    CHECK(Cauchy{width}.weight(s) == doctest::Approx(0.5));
    CHECK(GemanMcClure{width}.weight(s) == doctest::Approx(0.25));
    CHECK(Tukey{width}.weight(s) == doctest::Approx(0.0));
    CHECK(Tukey{width}.weight(0.5 * s) == doctest::Approx(0.25));
  }
}

}  // namespace
}  // namespace chainslam
