#pragma once

#include "chainslam/registration/surface_metric.hpp"

namespace chainslam {

/// Generalized ICP (Segal, Haehnel and Thrun 2009) with any covariances: the information of a pair is the inverse of
/// the sum of both, the source's turned into the target's axes.
///
/// The target needs `covariance(i)`, as `GaussianVoxelMap` has; the source has covariances or normals. A normal n
/// counts as the disc I - (1 - thickness) n n', see `PlaneToPlane`.
struct DistributionToDistribution {
  static constexpr Surface source_surface = Surface::covariance;  ///< what it needs to know of a source point
  static constexpr Surface target_surface = Surface::covariance;  ///< what it needs to know of a target point
  static constexpr int residuals_a_pair = 1;                      ///< residuals that a pair counts as
  /// Noise of normals has less effect here: pairs whose normals differ by it count for little. See `Icp`.
  static constexpr double degeneracy_threshold = 0.003;

  double thickness = 1e-3;  ///< of discs made from source normals, in (0, 1]
  /// Times the squared residual. 2 thickness makes it square metres across discs; 1 belongs to covariances in m^2 and
  /// makes it a number of standard deviations, squared.
  double scale = 2e-3;

  /// Information, pull and squared residual of a pair; see `SurfaceMetric`.
  template <class Number>
  void evaluate(const SurfacePair<Number>& pair, PairTerms<Number>& terms) const {
    std::array<Number, 6> sum;
    for (std::size_t i = 0; i < 6; ++i) sum[i] = pair.source_covariance[i] + pair.target_covariance[i];
    const auto& [xx, xy, xz, yy, yz, zz] = sum;
    const Number c0 = yy * zz - yz * yz, c1 = xz * yz - xy * zz, c2 = xy * yz - xz * yy;
    constexpr double nothing = 1e-60;  // a pair without any extent then tells nothing
    const Number factor = scale / (xx * c0 + xy * c1 + xz * c2 + nothing);
    terms.information = {factor * c0,
                         factor * c1,
                         factor * c2,
                         factor * (xx * zz - xz * xz),
                         factor * (xy * xz - xx * yz),
                         factor * (xx * yy - xy * xy)};
    detail::apply_information(pair, terms);
  }
};
static_assert(SurfaceMetric<DistributionToDistribution>);

}  // namespace chainslam
