#pragma once

#include <cmath>
#include <concepts>

namespace chainslam {

/// Weighs down outliers in least squares.
///
/// With the squared residual s, `weight(s)` is rho'(s) for some cost rho with rho(0) = 0 and rho'(0) = 1: it lies in
/// [0, 1] and never grows with s. Squares are of whatever the residual measures: metres for points, sigmas for whitened
/// factors.
template <class Kernel>
concept RobustKernel = requires(const Kernel& kernel, double squared_residual) {
  { kernel.weight(squared_residual) } -> std::same_as<double>;
};

/// A kernel that also knows rho(s) itself, for solvers that compare costs before and after a step.
template <class Kernel>
concept RobustCost = RobustKernel<Kernel> && requires(const Kernel& kernel, double squared_residual) {
  { kernel.cost(squared_residual) } -> std::same_as<double>;
};

// Weights and costs: Zhang 1997, table 1, and Barron 2019, with rho as a function of the squared residual.

/// Plain least squares.
struct Trivial {
  [[nodiscard]] double weight(double /*squared_residual*/) const { return 1.0; }
  [[nodiscard]] double cost(double squared_residual) const { return squared_residual; }
};

/// Quadratic up to `width`, linear beyond.
struct Huber {
  double width = 1.0;  ///< in the residual's unit

  [[nodiscard]] double weight(double squared_residual) const {
    return squared_residual <= width * width ? 1.0 : width / std::sqrt(squared_residual);
  }
  [[nodiscard]] double cost(double squared_residual) const {
    return squared_residual <= width * width ? squared_residual : width * (2.0 * std::sqrt(squared_residual) - width);
  }
};

/// Grows with the logarithm: far outliers keep a little say.
struct Cauchy {
  double width = 1.0;  ///< in the residual's unit; the weight there is 1/2

  [[nodiscard]] double weight(double squared_residual) const {
    return 1.0 / (1.0 + squared_residual / (width * width));
  }
  [[nodiscard]] double cost(double squared_residual) const {
    return width * width * std::log1p(squared_residual / (width * width));
  }
};

/// Bounded by `width`^2: far outliers have no say.
struct GemanMcClure {
  double width = 1.0;  ///< in the residual's unit; the weight there is 1/4

  [[nodiscard]] double weight(double squared_residual) const {
    const double share = 1.0 / (1.0 + squared_residual / (width * width));
    return share * share;
  }
  [[nodiscard]] double cost(double squared_residual) const {
    return squared_residual / (1.0 + squared_residual / (width * width));
  }
};

/// Constant beyond `width`: residuals there are not seen at all.
struct Tukey {
  double width = 1.0;  ///< in the residual's unit

  [[nodiscard]] double weight(double squared_residual) const {
    const double rest = 1.0 - squared_residual / (width * width);
    return rest > 0.0 ? rest * rest : 0.0;
  }
  [[nodiscard]] double cost(double squared_residual) const {
    const double rest = 1.0 - squared_residual / (width * width);
    return width * width / 3.0 * (rest > 0.0 ? 1.0 - rest * rest * rest : 1.0);
  }
};

static_assert(RobustCost<Trivial> && RobustCost<Huber> && RobustCost<Cauchy> && RobustCost<GemanMcClure> &&
              RobustCost<Tukey>);

}  // namespace chainslam
