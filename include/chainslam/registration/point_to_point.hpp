#pragma once

#include "chainslam/registration/surface_metric.hpp"

namespace chainslam {

/// The vector from the match to the moved point (Besl and McKay 1992).
struct PointToPoint {
  static constexpr Surface source_surface = Surface::nothing;  ///< what it needs to know of a source point
  static constexpr Surface target_surface = Surface::nothing;  ///< what it needs to know of a target point
  static constexpr int residuals_a_pair = 3;                   ///< residuals that a pair counts as

  /// Information, pull and squared residual of a pair; see `SurfaceMetric`.
  template <class Number>
  void evaluate(const SurfacePair<Number>& pair, PairTerms<Number>& terms) const {
    const auto& d = pair.offset;
    terms.information = {Number(1.0), Number(0.0), Number(0.0), Number(1.0), Number(0.0), Number(1.0)};
    terms.pull = d;
    terms.squared_residual = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
  }
};
static_assert(SurfaceMetric<PointToPoint>);

}  // namespace chainslam
