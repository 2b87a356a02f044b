#pragma once

#include <algorithm>
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
  /// Weight of a squared residual, 0 to 1 at most.
  [[nodiscard]] double weight(double /*squared_residual*/) const { return 1.0; }
  /// Cost of a squared residual; its derivative is the weight.
  [[nodiscard]] double cost(double squared_residual) const { return squared_residual; }
};

/// Quadratic up to `width`, linear beyond.
struct Huber {
  double width = 1.0;  ///< in the residual's unit

  /// Weight of a squared residual, 0 to 1 at most.
  [[nodiscard]] double weight(double squared_residual) const {
    return squared_residual <= width * width ? 1.0 : width / std::sqrt(squared_residual);
  }
  /// Cost of a squared residual; its derivative is the weight.
  [[nodiscard]] double cost(double squared_residual) const {
    return squared_residual <= width * width ? squared_residual : width * (2.0 * std::sqrt(squared_residual) - width);
  }
};

/// Grows with the logarithm: far outliers keep a little say.
struct Cauchy {
  double width = 1.0;  ///< in the residual's unit; the weight there is 1/2

  /// Weight of a squared residual, 0 to 1 at most.
  [[nodiscard]] double weight(double squared_residual) const {
    return 1.0 / (1.0 + squared_residual / (width * width));
  }
  /// Cost of a squared residual; its derivative is the weight.
  [[nodiscard]] double cost(double squared_residual) const {
    return width * width * std::log1p(squared_residual / (width * width));
  }
};

/// Bounded by `width`^2: far outliers have no say.
struct GemanMcClure {
  double width = 1.0;  ///< in the residual's unit; the weight there is 1/4

  /// Weight of a squared residual, 0 to 1 at most.
  [[nodiscard]] double weight(double squared_residual) const {
    const double share = 1.0 / (1.0 + squared_residual / (width * width));
    return share * share;
  }
  /// Cost of a squared residual; its derivative is the weight.
  [[nodiscard]] double cost(double squared_residual) const {
    return squared_residual / (1.0 + squared_residual / (width * width));
  }
};

/// Constant beyond `width`: residuals there are not seen at all.
struct Tukey {
  double width = 1.0;  ///< in the residual's unit

  /// Weight of a squared residual, 0 to 1 at most.
  [[nodiscard]] double weight(double squared_residual) const {
    const double rest = 1.0 - squared_residual / (width * width);
    return rest > 0.0 ? rest * rest : 0.0;
  }
  /// Cost of a squared residual; its derivative is the weight.
  [[nodiscard]] double cost(double squared_residual) const {
    const double rest = 1.0 - squared_residual / (width * width);
    return width * width / 3.0 * (rest > 0.0 ? 1.0 - rest * rest * rest : 1.0);
  }
};

/// Least squares up to `width`, nothing beyond: residuals there cost the same, however large.
struct Truncated {
  double width = 1.0;  ///< in the residual's unit

  /// Weight of a squared residual, 0 to 1 at most.
  [[nodiscard]] double weight(double squared_residual) const { return squared_residual <= width * width ? 1.0 : 0.0; }
  /// Cost of a squared residual; its derivative is the weight.
  [[nodiscard]] double cost(double squared_residual) const {
    return squared_residual <= width * width ? squared_residual : width * width;
  }
};

/// Quadratic up to `width`, then a switch that closes the more, the larger the residual: dynamic covariance scaling
/// (Agarwal et al. 2013), with Phi = `width`^2. Bounded by 3 `width`^2.
struct DynamicCovarianceScaling {
  double width = 1.0;  ///< in the residual's unit

  /// Weight of a squared residual, 0 to 1 at most.
  [[nodiscard]] double weight(double squared_residual) const {
    const double phi = width * width;
    if (squared_residual <= phi) return 1.0;
    const double scale = 2.0 / (1.0 + squared_residual / phi);
    return scale * scale;
  }
  /// Cost of a squared residual; its derivative is the weight.
  [[nodiscard]] double cost(double squared_residual) const {
    const double phi = width * width;
    return squared_residual <= phi ? squared_residual : 3.0 * phi - 4.0 * phi / (1.0 + squared_residual / phi);
  }
};

/// A family from least squares to functions that no far outlier moves, by its `shape` (Barron 2019, eq. 8): 2 is least
/// squares, 1 a smooth Huber, 0 a Cauchy of sqrt(2) `width`, -2 a Geman and McClure of 2 `width`; smaller ones come
/// near to 1 - exp(-s / (2 `width`^2)).
struct Barron {
  double width = 1.0;  ///< in the residual's unit
  double shape = 1.0;  ///< <= 2

  /// Weight of a squared residual, 0 to 1 at most.
  [[nodiscard]] double weight(double squared_residual) const {
    const double s = squared_residual / (width * width);
    if (shape == 2.0) return 1.0;
    return std::pow(s / (2.0 - shape) + 1.0, 0.5 * shape - 1.0);
  }
  /// Cost of a squared residual; its derivative is the weight.
  [[nodiscard]] double cost(double squared_residual) const {
    const double s = squared_residual / (width * width);
    if (shape == 2.0) return squared_residual;
    const double growth = std::log1p(s / (2.0 - shape));
    // (e^(shape growth / 2) - 1) / shape, which has a limit at 0.
    const double exponential = shape == 0.0 ? 0.5 * growth : std::expm1(0.5 * shape * growth) / shape;
    return 2.0 * width * width * (2.0 - shape) * exponential;
  }
};

static_assert(RobustCost<Trivial> && RobustCost<Huber> && RobustCost<Cauchy> && RobustCost<GemanMcClure> &&
              RobustCost<Tukey> && RobustCost<Truncated> && RobustCost<DynamicCovarianceScaling> && RobustCost<Barron>);

/// Weight of a truncated square under graduated non-convexity (Yang, Antonante, Tzoumas and Carlone 2020, eq. 14), for
/// the control parameter mu: from a cost nearly convex, mu near 0, to in or out, mu large.
[[nodiscard]] inline double truncated_weight(double squared, double threshold, double mu) {
  if (squared <= mu / (mu + 1.0) * threshold) return 1.0;
  if (squared >= (mu + 1.0) / mu * threshold) return 0.0;
  return std::clamp(std::sqrt(threshold * mu * (mu + 1.0) / squared) - mu, 0.0, 1.0);
}

/// The squared length that a residual of `rows` independent rows of unit deviation exceeds once in a hundred times
/// (Wilson and Hilferty 1931; within 1 %).
[[nodiscard]] inline double chi_squared_99(int rows) {
  const double share = 2.0 / (9.0 * rows);
  const double root = 1.0 - share + 2.3263479 * std::sqrt(share);
  return rows * root * root * root;
}

}  // namespace chainslam
