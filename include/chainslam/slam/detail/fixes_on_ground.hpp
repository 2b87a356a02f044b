#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <span>

#include "chainslam/core/types.hpp"
#include "chainslam/slam/georeference.hpp"

// Paths and their GNSS fixes along the ground: heights of fixes say little.

namespace chainslam::detail {

/// A rotation about the vertical and a shift along the ground.
struct OnGround {
  double cosine = 1, sine = 0, x = 0, y = 0;

  /// Metres along the ground from where a fix is to where its position is put.
  [[nodiscard]] Eigen::Vector2d error(const FixedPosition& fix) const {
    const double px = fix.position.x(), py = fix.position.y();
    return {cosine * px - sine * py + x - fix.ecef.x(), sine * px + cosine * py + y - fix.ecef.y()};
  }
};

/// What brings positions closest to their fixes, which are in a frame of the ground as well: least squares.
template <class Fix>
[[nodiscard]] [[gnu::cold]] OnGround onto_fixes(std::span<const Fix> fixes) {
  const double share = 1 / static_cast<double>(fixes.size());
  double px = 0, py = 0, ex = 0, ey = 0, dot = 0, cross = 0;
  for (const FixedPosition& fix : fixes) {
    px += share * fix.position.x(), py += share * fix.position.y();
    ex += share * fix.ecef.x(), ey += share * fix.ecef.y();
  }
  for (const FixedPosition& fix : fixes) {
    const double x = fix.position.x() - px, y = fix.position.y() - py;
    dot += x * (fix.ecef.x() - ex) + y * (fix.ecef.y() - ey);
    cross += x * (fix.ecef.y() - ey) - y * (fix.ecef.x() - ex);
  }
  OnGround found;
  if (const double length = std::hypot(dot, cross); length > 0) found = {dot / length, cross / length, 0, 0};
  found.x = ex - (found.cosine * px - found.sine * py);
  found.y = ey - (found.sine * px + found.cosine * py);
  return found;
}

/// A keyframe's fix in the frame of the map: `ecef` is there.
struct FixInMap : FixedPosition {
  Index keyframe = 0;
  double time = 0;      ///< seconds
  double variance = 0;  ///< of an axis, as stated, square metres
};

/// How differently from its fixes a path goes, in squared deviations.
///
/// Errors of fixes are a Gauss-Markov process. With a standard deviation s and a correlation f from one to the next,
/// the squared deviations of its errors e are, but for the ends, the sum of (1 - f) / (1 + f) e_i^2 / s^2, which is
/// what `correlated_fixes` leaves of each fix, and of f / (1 - f^2) (e_i - e_i-1)^2 / s^2, which is this. An error that
/// comes and goes at once, as that of a reflected signal, counts only where it does.
/// @param motion  of all positions but the first
/// @pre fixes are in the order of time, and not empty.
template <class Motion>
[[nodiscard]] [[gnu::cold]] double squared_differences(std::span<const FixInMap> fixes, const Motion& motion,
                                                       const GnssFactorOptions& options) {
  constexpr double most = 13.8;  // one in a thousand is more by chance
  double sum = 0;
  Eigen::Vector2d last = OnGround().error(fixes[0]);
  for (std::size_t i = 1; i < fixes.size(); ++i) {
    const FixInMap &a = fixes[i - 1], &b = fixes[i];
    const double f = std::exp((a.time - b.time) / options.correlation_time);
    const double variance = options.bias * options.bias * (1 - f * f) / f + a.variance + b.variance;
    const Eigen::Vector2d error = motion.error(b);
    const double x = error.x() - last.x(), y = error.y() - last.y();
    sum += std::min((x * x + y * y) / variance, most);
    last = error;
  }
  return sum;
}

}  // namespace chainslam::detail
