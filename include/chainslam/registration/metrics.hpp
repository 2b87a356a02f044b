#pragma once

#include <array>
#include <concepts>

namespace chainslam {

/// What a metric wants to know of the surface at a point, besides where it is.
enum class Surface { nothing, normal, covariance };

/// A source point and its match, all in the target's axes. Only what the metric asked for is set. A point that has no
/// normal has zeros. Covariances are xx, xy, xz, yy, yz, zz.
template <class Number>
struct SurfacePair {
  std::array<Number, 3> offset;             ///< from the match to the moved source point, metres
  std::array<Number, 3> source_normal;      ///< unit length, in the target's axes
  std::array<Number, 3> target_normal;      ///< unit length
  std::array<Number, 6> source_covariance;  ///< in the target's axes
  std::array<Number, 6> target_covariance;  ///< in the target's axes
};

/// The squared residual offset' M offset of a pair.
template <class Number>
struct PairTerms {
  std::array<Number, 6> information;  ///< M: xx, xy, xz, yy, yz, zz; positive semi-definite
  std::array<Number, 3> pull;         ///< M offset
  Number squared_residual;            ///< offset' M offset
};

/// Measures a pair by a squared residual that is a quadratic form of the offset.
///
/// `source_surface` and `target_surface` say what it needs; `evaluate(pair, terms)` is a template on the number type,
/// which has + - * / and mixes with double: some pairs are worked on at a time. M is held fixed for the derivative.
template <class M>
concept SurfaceMetric = requires(const M& metric, const SurfacePair<double>& pair, PairTerms<double>& terms) {
  { M::source_surface } -> std::convertible_to<Surface>;
  { M::target_surface } -> std::convertible_to<Surface>;
  { M::residuals_a_pair } -> std::convertible_to<int>;
  metric.evaluate(pair, terms);
};

namespace detail {

/// Fills in pull and squared residual from the information.
template <class Number>
void apply_information(const SurfacePair<Number>& pair, PairTerms<Number>& terms) {
  const auto& d = pair.offset;
  const auto& m = terms.information;
  terms.pull[0] = m[0] * d[0] + m[1] * d[1] + m[2] * d[2];
  terms.pull[1] = m[1] * d[0] + m[3] * d[1] + m[4] * d[2];
  terms.pull[2] = m[2] * d[0] + m[4] * d[1] + m[5] * d[2];
  terms.squared_residual = d[0] * terms.pull[0] + d[1] * terms.pull[1] + d[2] * terms.pull[2];
}

}  // namespace detail

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
