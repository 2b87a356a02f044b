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

}  // namespace chainslam
