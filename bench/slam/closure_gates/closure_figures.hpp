#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <limits>
#include <map>
#include <memory>
#include <numbers>
#include <span>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/registration/alignment_checks.hpp"
#include "chainslam/slam/loop_closer.hpp"
#include "slam/closure_gates/closure_pairs.hpp"

namespace chainslam::bench {

/// Whether an alignment ended where the scan was.
enum class PairOutcome { right, unclear, wrong };

[[nodiscard]] inline const char* name_of(PairOutcome outcome) {
  return outcome == PairOutcome::right ? "right" : outcome == PairOutcome::unclear ? "unclear" : "wrong";
}

/// What is known of an alignment without the truth, and the truth.
struct ClosureFigures {
  AlignResult aligned;
  bool ended = false;            ///< as the gate asks: not while it was still moving
  bool accepted = false;         ///< by the gate's defaults
  double rmse = 0;               ///< of `SurfaceFit`, metres
  double overlap = 0;            ///< the same
  double noise = 0;              ///< `surface_noise` of the submap, metres
  double misfit = 0;             ///< infinite if nothing overlaps
  double worst_misfit = 0;       ///< of the worst direction
  double partial_misfit = 0;     ///< the same by the four fifths that lie nearest
  double localizability = 0;     ///< `weakest_direction`
  bool sure = false;             ///< `ClosureGate::is_sure`
  bool repeatable = false;       ///< `is_repeatable`, of what is neither sure nor far from fitting
  double contradiction = 0;      ///< share of the submap that the scan saw through, of what it does not hide
  double own_contradiction = 0;  ///< the same of the scan at the submap's centre
  double seen_through = 0;       ///< the first less one and a half times the second
  double before_map = 0;         ///< share of the scan's points in view that the submap's nearest scans saw through
  double correction = 0;         ///< metres from the guess
  double turn = 0;               ///< radians from the guess
  double metres_off = std::numeric_limits<double>::infinity();   ///< infinite between two places
  double degrees_off = std::numeric_limits<double>::infinity();  ///< the same
  PairOutcome outcome = PairOutcome::wrong;
  double align_us = 0, fit_us = 0, repeat_us = 0, scan_view_us = 0, map_view_us = 0;
};

/// Aligns pairs as the loop closer does by its defaults.
class ClosureMeasurer {
 public:
  /// @param full  whether the scan is aligned as it was recorded; there has to be one.
  [[nodiscard]] ClosureFigures operator()(const ClosurePair& pair, bool full) {
    const std::span<const Keyframe> keyframes = pair.map->keyframes;
    SubmapCache& submaps = cache_of(*pair.map);
    const PlacedSubmap placed = submaps.get(keyframes, KeyframeId{to_index(pair.from)});
    const std::shared_ptr<const Submap>& submap = placed.submap;
    const auto own = full ? pair.query->full[pair.to] : pair.query->keyframes[pair.to].cloud.load();
    const PointCloud<float>& scan = *own;
    ClosureFigures figures;
    figures.noise = submaps.surface_noise(*submap);
    const SE3d guess = placed.T_keyframe_submap.inverse() * pair.guess;
    timed(figures.align_us, [&] { figures.aligned = registration_.align(scan, *submap, guess); });
    const SE3d T = figures.aligned.T_target_source;
    figures.aligned.T_target_source = placed.T_keyframe_submap * T;
    SurfaceFit fit;
    timed(figures.fit_us, [&] { fit = surface_fit(scan, *submap, T); });
    figures.rmse = fit.rmse;
    figures.overlap = fit.overlap;
    figures.misfit = fit.misfit(figures.noise);
    figures.worst_misfit = fit.worst_misfit(figures.noise);
    const ClosureGate gate{};
    figures.partial_misfit = gate.misfit(scan, *submap, figures.noise, T);
    AlignResult in_submap = figures.aligned;
    in_submap.T_target_source = T;
    figures.localizability = weakest_direction(in_submap).localizability;
    figures.sure = gate.is_sure(in_submap, figures.partial_misfit);
    constexpr double near_gate = 2;  // times its misfit: nothing beyond is accepted anyway
    if (!figures.sure && figures.partial_misfit <= near_gate * gate.max_misfit)
      timed(figures.repeat_us, [&] {
        figures.repeatable =
            is_repeatable(registration_, scan, *submap, in_submap, gate.repeat_shift, gate.repeat_distance);
      });
    timed(figures.scan_view_us, [&] {
      figures.contradiction =
          FreeSpace(scan, Eigen::Vector3d::Zero()).count(submap->cloud(), T.inverse()).contradiction();
    });
    figures.own_contradiction = FreeSpace(*keyframes[pair.from].cloud.load(), Eigen::Vector3d::Zero())
                                    .count(submap->cloud(), placed.T_keyframe_submap)
                                    .contradiction();
    figures.seen_through = figures.contradiction - 1.5 * figures.own_contradiction;
    timed(figures.map_view_us,
          [&] { figures.before_map = before_map(pair, scan, figures.aligned.T_target_source).share(); });
    judge(pair, figures);
    return figures;
  }

 private:
  using Clock = std::chrono::steady_clock;

  template <class Work>
  static void timed(double& microseconds, const Work& work) {
    const auto begin = Clock::now();
    work();
    microseconds = std::chrono::duration<double, std::micro>(Clock::now() - begin).count();
  }

  [[nodiscard]] SubmapCache& cache_of(const KnownDrive& map) {
    if (map_ != &map) {
      submaps_ = SubmapCache(LoopCloserOptions{}.submap);
      map_ = &map;
    }
    return submaps_;
  }

  /// Points of the scan that the scans of the submap nearest to it saw through.
  [[nodiscard]] static FreeSpaceCount before_map(const ClosurePair& pair, const PointCloud<float>& scan,
                                                 const SE3d& T_from_to) {
    constexpr std::size_t viewpoints = 3;
    const std::vector<Keyframe>& keyframes = pair.map->keyframes;
    const SubmapRange range =
        submap_range(keyframes, KeyframeId{to_index(pair.from)}, LoopCloserOptions{}.submap.radius);
    const SE3d T_map_scan = keyframes[pair.from].T_map_body * T_from_to;
    std::vector<std::pair<double, std::size_t>> nearest;
    for (auto i = static_cast<std::size_t>(range.begin); i < static_cast<std::size_t>(range.end); ++i)
      nearest.emplace_back((keyframes[i].T_map_body.translation() - T_map_scan.translation()).norm(), i);
    std::ranges::sort(nearest);
    FreeSpaceCount count;
    for (std::size_t k = 0; k < std::min(viewpoints, nearest.size()); ++k) {
      const Keyframe& keyframe = keyframes[nearest[k].second];
      count += FreeSpace(*keyframe.cloud.load(), Eigen::Vector3d::Zero())
                   .count(scan, keyframe.T_map_body.inverse() * T_map_scan);
    }
    return count;
  }

  static void judge(const ClosurePair& pair, ClosureFigures& figures) {
    const AlignResult& aligned = figures.aligned;
    const ClosureGate gate{};
    figures.accepted = gate.judge(aligned, pair.guess) == ClosureVerdict::accepted &&
                       figures.partial_misfit <= gate.max_misfit && (figures.sure || figures.repeatable);
    figures.ended = aligned.status == AlignStatus::converged || aligned.status == AlignStatus::degenerate;
    const SE3d correction = pair.guess.inverse() * aligned.T_target_source;
    figures.correction = correction.translation().norm();
    figures.turn = correction.rotation().log().norm();
    if (!pair.truth) return;
    const SE3d off = pair.truth->inverse() * aligned.T_target_source;
    figures.metres_off = off.translation().norm();
    figures.degrees_off = off.rotation().log().norm() * 180 / std::numbers::pi;
    figures.outcome = figures.metres_off < 0.75 && figures.degrees_off < 2  ? PairOutcome::right
                      : figures.metres_off > 1.5 || figures.degrees_off > 5 ? PairOutcome::wrong
                                                                            : PairOutcome::unclear;
  }

  CoarseToFine<> registration_{};
  const KnownDrive* map_ = nullptr;
  SubmapCache submaps_{};
};

}  // namespace chainslam::bench
