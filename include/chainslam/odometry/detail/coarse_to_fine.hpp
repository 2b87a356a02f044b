#pragma once

#include "chainslam/core/types.hpp"

namespace chainslam::detail {

/// The error that registration still expects of a pose, metres: the scale of its gate and of its robust kernel.
///
/// It is halved after each iteration, but while it is coarse only once the pose has converged under it: a gate that
/// shrinks while the pose still moves rejects the very points that pull it to its place.
class CoarseToFine {
 public:
  /// @param error  metres, of the initial guess. @param rule  with the settings of `ScanToMap`.
  template <class Rule>
  CoarseToFine(double error, const Rule& rule)
      : error_(error),
        finest_(2 * rule.residual_scale),
        tolerance_(rule.coarse_tolerance),
        max_iterations_(rule.max_coarse_iterations) {}

  [[nodiscard]] double error() const { return error_; }
  /// Above what leaves the kernel its final scale.
  [[nodiscard]] bool coarse() const { return error_ > finest_; }
  /// Iterations that left the error as it was.
  [[nodiscard]] Index iterations() const { return iterations_; }

  /// Takes how far the last iteration moved the points, metres.
  void follow(double step) {
    if (!coarse() || iterations_ == max_iterations_ || step <= tolerance_ * error_)
      error_ *= 0.5;
    else
      ++iterations_;
  }

 private:
  double error_, finest_, tolerance_;
  Index max_iterations_, iterations_ = 0;
};

}  // namespace chainslam::detail
