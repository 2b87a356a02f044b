#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <span>
#include <vector>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/slam/back_end_options.hpp"
#include "chainslam/slam/detail/fixes_on_ground.hpp"
#include "chainslam/slam/georeference.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam::detail {

/// What the GNSS fixes of two parts of a map say of how the parts lie to each other.
enum class FixVerdict {
  silent,      ///< too few fixes, too much on one spot, or in between
  agree,       ///< the paths are aligned with each other as the fixes are
  contradict,  ///< they do not, by far more than fixes and odometry err
};

/// Compares the whole paths of two parts of a map with their fixes, along the ground: the way between two positions
/// must be the one between their fixes. Medians decide, so that fewer than half of the fixes may say anything.
class FixEvidence {
 public:
  explicit FixEvidence(const FixEvidenceOptions& options = {}) : options_(options) {}  ///< starts without fixes

  /// @param is_a, is_b  bool(const Session&): whether a session belongs to the part
  /// @param T_a_b       carries the second part's frame over into the first one's
  template <class IsA, class IsB>
  [[nodiscard]] [[gnu::cold]] FixVerdict operator()(const SlamMap& map, const IsA& is_a, const IsB& is_b,
                                                    const SE3d& T_a_b) const {
    if (!(options_.max_difference > 0)) return FixVerdict::silent;
    Part a, b;
    for (const Keyframe& keyframe : map.keyframes) {
      if (!usable(keyframe)) continue;
      const Session& session = map.sessions[static_cast<std::size_t>(keyframe.session.value)];
      if (is_a(session)) a.push_back({keyframe.T_map_body.translation(), keyframe.gnss->position_ecef});
      if (is_b(session)) b.push_back({T_a_b * keyframe.T_map_body.translation(), keyframe.gnss->position_ecef});
    }
    if (std::min(a.size(), b.size()) < options_.min_fixes) return FixVerdict::silent;
    flatten(a, b);
    const double spread_a = spread(a), spread_b = spread(b);
    if (!(std::max(spread_a, spread_b) >= options_.min_spread)) return FixVerdict::silent;
    const double off = spread_a >= spread_b ? discrepancy(a, spread_a, b) : discrepancy(b, spread_b, a);
    if (off > options_.contradiction) return FixVerdict::contradict;
    return off <= 1 && std::min(spread_a, spread_b) >= options_.min_spread ? FixVerdict::agree : FixVerdict::silent;
  }

 private:
  using Part = detail::Table<FixedPosition>;

  [[nodiscard]] bool usable(const Keyframe& keyframe) const {
    return keyframe.gnss && is_usable(*keyframe.gnss, GnssFactorOptions{.max_sigma = options_.max_sigma});
  }

  [[nodiscard]] static Eigen::Vector3d middle(const Part& part, Eigen::Vector3d FixedPosition::*of) {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (const FixedPosition& fix : part)
      for (int k = 0; k < 3; ++k) sum[k] += (fix.*of)[k] / static_cast<double>(part.size());
    return sum;
  }

  /// Makes the fixes local: east, north and up of where they are.
  [[gnu::cold]] static void flatten(Part& a, Part& b) {
    const Eigen::Vector3d base = middle(a, &FixedPosition::ecef);
    const double around = std::hypot(base.x(), base.y()), length = std::hypot(around, base.z());
    const double east[3] = {-base.y() / around, base.x() / around, 0};
    const double up[3] = {base.x() / length, base.y() / length, base.z() / length};
    const double north[3] = {-up[2] * east[1], up[2] * east[0], up[0] * east[1] - up[1] * east[0]};  // up x east
    for (Part* part : {&a, &b})
      for (FixedPosition& fix : *part) {
        const Eigen::Vector3d way = difference_of(fix.ecef, base);
        const auto along = [&](const double* axis) {
          return axis[0] * way.x() + axis[1] * way.y() + axis[2] * way.z();
        };
        fix.ecef = Eigen::Vector3d(along(east), along(north), along(up));
      }
  }

  /// Metres (rms) along the main direction on the ground.
  [[nodiscard]] [[gnu::cold]] static double spread(const Part& part) {
    const Eigen::Vector3d center = middle(part, &FixedPosition::position);
    double xx = 0, xy = 0, yy = 0;
    for (const FixedPosition& fix : part) {
      const double x = fix.position.x() - center.x(), y = fix.position.y() - center.y();
      xx += x * x;
      xy += x * y;
      yy += y * y;
    }
    const double largest = 0.5 * (xx + yy) + std::hypot(0.5 * (xx - yy), xy);
    return std::sqrt(largest / static_cast<double>(part.size()));
  }

  /// Metres along the ground between where a position is put and where its fix is.
  [[nodiscard]] static double distance(const OnGround& ground, const FixedPosition& fix) {
    const Eigen::Vector2d error = ground.error(fix);
    return std::hypot(error.x(), error.y());
  }

  [[nodiscard]] static double median(detail::Table<Ranked>& values) {
    sort_ranked(values.all());
    return values[values.size() / 2].rank;
  }

  /// Where the fixes put a part on the ground: least squares, several times, each without fixes that the last was off
  /// by more than twice the median.
  [[nodiscard]] [[gnu::cold]] static OnGround fit(const Part& part) {
    OnGround found;
    double most = std::numeric_limits<double>::infinity();
    for (int pass = 0; pass < 6; ++pass) {
      Part kept;
      for (const FixedPosition& fix : part)
        if (pass == 0 || distance(found, fix) <= most) kept.push_back(fix);
      found = onto_fixes(std::span<const FixedPosition>(kept.all()));
      detail::Table<Ranked> off;
      for (const FixedPosition& fix : part) off.push_back({distance(found, fix), 0});
      most = std::max(2 * median(off), 1e-3);
    }
    return found;
  }

  /// Median over `seen` of how far its fixes are from where `known` puts them, by what is allowed: as much again for
  /// each spread of `known` that a fix lies away from its middle, since fixes turn it.
  [[nodiscard]] [[gnu::cold]] double discrepancy(const Part& known, double spread_known, const Part& seen) const {
    const OnGround ground = fit(known);
    const Eigen::Vector3d center = middle(known, &FixedPosition::position);
    detail::Table<Ranked> off;
    for (const FixedPosition& fix : seen) {
      const double away = distance(ground, {center, fix.ecef});
      off.push_back({distance(ground, fix) / (options_.max_difference * (1 + away / spread_known)), 0});
    }
    return median(off);
  }

  FixEvidenceOptions options_;
};

/// Accepted closures between sessions of one frame whose fixes contradict where the frame has them, by their positions
/// among the map's.
[[nodiscard]] [[gnu::cold]] inline detail::Table<Index> contradicted_closures(const SlamMap& map,
                                                                              const FixEvidence& evidence) {
  detail::Table<Index> found;
  const Index sessions = to_index(map.sessions.size());
  detail::Table<char> asked(static_cast<Offset>(sessions) * sessions, 0);  // of each pair: 1 no contradiction, 2 one
  for (Index i = 0; i < to_index(map.closures.size()); ++i) {
    const LoopClosure& closure = map.closures[static_cast<std::size_t>(i)];
    const auto session = [&](KeyframeId id) { return map.keyframes[static_cast<std::size_t>(id.value)].session; };
    const SessionId a = std::min(session(closure.from), session(closure.to));
    const SessionId b = std::max(session(closure.from), session(closure.to));
    if (a == b || closure.verdict != ClosureVerdict::accepted) continue;
    char& answer = asked[static_cast<Offset>(a.value) * sessions + b.value];
    if (answer == 0)
      answer = evidence(
                   map, [&](const Session& one) { return one.id == a; },
                   [&](const Session& one) { return one.id == b; }, SE3d()) == FixVerdict::contradict
                   ? 2
                   : 1;
    if (answer == 2) found.push_back(i);
  }
  return found;
}

}  // namespace chainslam::detail
