#include "chainslam/core/robust_kernels.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <type_traits>

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
  if constexpr (std::is_base_of_v<Barron, Kernel>)
    return Kernel(width);
  else if constexpr (requires(Kernel kernel) { kernel.width; })
    return Kernel{.width = width};
  else
    return Kernel{};
}

template <int TwiceShape>
struct BarronOf : Barron {
  explicit BarronOf(double of_width = 1.0) : Barron{of_width, 0.5 * TwiceShape} {}
};

TEST_SUITE("core/robust_kernels") {
  TEST_CASE_TEMPLATE("weight is the derivative of cost", Kernel, Trivial, Huber, Cauchy, GemanMcClure, Tukey, Truncated,
                     DynamicCovarianceScaling, BarronOf<3>, BarronOf<0>, BarronOf<-4>, BarronOf<-40>) {
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

  TEST_CASE_TEMPLATE("a kernel is least squares near zero", Kernel, Trivial, Huber, Cauchy, GemanMcClure, Tukey,
                     Truncated, DynamicCovarianceScaling, BarronOf<3>, BarronOf<0>, BarronOf<-4>, BarronOf<-40>) {
    const auto kernel = kernel_of_width<Kernel>(0.5);
    CHECK(kernel.weight(0.0) == 1.0);
    CHECK(kernel.cost(0.0) == 0.0);
    CHECK(kernel.cost(1e-8) == doctest::Approx(1e-8).epsilon(1e-6));
  }

  TEST_CASE_TEMPLATE("weights lie in [0, 1] and never grow, costs never fall", Kernel, Trivial, Huber, Cauchy,
                     GemanMcClure, Tukey, Truncated, DynamicCovarianceScaling, BarronOf<3>, BarronOf<0>, BarronOf<-4>,
                     BarronOf<-40>) {
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

  TEST_CASE_TEMPLATE("an infinite residual has no weight", Kernel, Huber, Cauchy, GemanMcClure, Tukey, Truncated,
                     DynamicCovarianceScaling, BarronOf<3>, BarronOf<0>, BarronOf<-4>) {
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

  TEST_CASE("Barron's family holds others of them") {
    for (double s = 1e-3; s < 1e3; s *= 2.0) {
      CHECK(Barron{1.5, 2.0}.cost(s) == doctest::Approx(s));
      CHECK(Barron{1.5, 0.0}.cost(s) == doctest::Approx(Cauchy{1.5 * std::sqrt(2.0)}.cost(s)));
      CHECK(Barron{1.5, -2.0}.cost(s) == doctest::Approx(GemanMcClure{3.0}.cost(s)));
      CHECK(Barron{1.5, 1.0}.cost(s) == doctest::Approx(4.5 * (std::sqrt(s / 2.25 + 1.0) - 1.0)));
      CHECK(Barron{1.5, -1e6}.cost(s) == doctest::Approx(4.5 * (1.0 - std::exp(-s / 4.5))).epsilon(1e-4));
    }
  }

  TEST_CASE("dynamic covariance scaling closes its switch as in Agarwal et al. 2013") {
    const double width = 2.0, phi = 4.0;
    for (const double s : {1.0, 5.0, 100.0}) {
      const double scale = std::min(1.0, 2.0 * phi / (phi + s));
      CHECK(DynamicCovarianceScaling{width}.weight(s) == doctest::Approx(scale * scale));
    }
  }
}

}  // namespace
}  // namespace chainslam
