#pragma once

#include "chainslam/registration/surface_metric.hpp"

namespace chainslam {

/// Generalized ICP (Segal, Haehnel and Thrun 2009) with surfaces that are planes: both points are thought to lie
/// anywhere near on a disc across their normal, of variance 1 along it and `thickness` across.
///
/// The covariance of such a disc is I - (1 - thickness) n n', so that the information of a pair, the inverse of the sum
/// of two, follows from the two normals in closed form (Woodbury). It is given times 2 `thickness`: where the normals
/// agree, the residual is the distance of the planes in metres, and offsets along them count `thickness` times; where
/// they do not, the pair counts for little. A point without a normal (zero) is a ball of variance 1.
/// Both sides need normals; their signs do not matter.
struct PlaneToPlane {
  static constexpr Surface source_surface = Surface::normal;  ///< what it needs to know of a source point
  static constexpr Surface target_surface = Surface::normal;  ///< what it needs to know of a target point
  static constexpr int residuals_a_pair = 1;                  ///< residuals that a pair counts as
  /// Noise of normals has less effect here: pairs whose normals differ by it count for little. See `Icp`.
  static constexpr double degeneracy_threshold = 0.003;

  double thickness = 1e-3;  ///< variance across over variance along, in (0, 1]

  /// Information, pull and squared residual of a pair; see `SurfaceMetric`.
  template <class Number>
  void evaluate(const SurfacePair<Number>& pair, PairTerms<Number>& terms) const {
    const auto& n = pair.target_normal;
    const auto& m = pair.source_normal;
    const double h = 0.5 * (1.0 - thickness);
    const Number rest_n = 1.0 - h * (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    const Number rest_m = 1.0 - h * (m[0] * m[0] + m[1] * m[1] + m[2] * m[2]);
    const Number common = h * (n[0] * m[0] + n[1] * m[1] + n[2] * m[2]);
    const Number scale = (thickness * h) / (rest_n * rest_m - common * common);
    const Number nn = scale * rest_m, mm = scale * rest_n, nm = scale * common;
    // a = nn n + nm m and b = nm n + mm m: the sum is n a' + m b'.
    const std::array<Number, 3> a{nn * n[0] + nm * m[0], nn * n[1] + nm * m[1], nn * n[2] + nm * m[2]};
    const std::array<Number, 3> b{nm * n[0] + mm * m[0], nm * n[1] + mm * m[1], nm * n[2] + mm * m[2]};
    terms.information = {
        thickness + n[0] * a[0] + m[0] * b[0], n[0] * a[1] + m[0] * b[1], n[0] * a[2] + m[0] * b[2],
        thickness + n[1] * a[1] + m[1] * b[1], n[1] * a[2] + m[1] * b[2], thickness + n[2] * a[2] + m[2] * b[2]};
    detail::apply_information(pair, terms);
  }
};
static_assert(SurfaceMetric<PlaneToPlane>);

}  // namespace chainslam
