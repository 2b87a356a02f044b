#pragma once

#include "chainslam/registration/surface_metric.hpp"

namespace chainslam {

/// The distance of the moved point from the plane through the match (Chen and Medioni 1992). The target needs normals;
/// a point without one (zero or not finite) contributes nothing.
struct PointToPlane {
  static constexpr Surface source_surface = Surface::nothing;  ///< what it needs to know of a source point
  static constexpr Surface target_surface = Surface::normal;   ///< what it needs to know of a target point
  static constexpr int residuals_a_pair = 1;                   ///< residuals that a pair counts as

  /// Information, pull and squared residual of a pair; see `SurfaceMetric`.
  template <class Number>
  void evaluate(const SurfacePair<Number>& pair, PairTerms<Number>& terms) const {
    const auto& d = pair.offset;
    const auto& n = pair.target_normal;
    const Number distance = n[0] * d[0] + n[1] * d[1] + n[2] * d[2];
    terms.information = {n[0] * n[0], n[0] * n[1], n[0] * n[2], n[1] * n[1], n[1] * n[2], n[2] * n[2]};
    terms.pull = {n[0] * distance, n[1] * distance, n[2] * distance};
    terms.squared_residual = distance * distance;
  }
};
static_assert(SurfaceMetric<PointToPlane>);

}  // namespace chainslam
