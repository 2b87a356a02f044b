#pragma once

#include "chainslam/core/types.hpp"
#include "chainslam/slam/fix_evidence.hpp"

namespace chainslam {

/// What measures a merge's closure, once the submaps are aligned.
enum class MergeMeasurement {
  refined,  ///< alignment of the scan to the submap, which must accept the place too
  submaps,  ///< the registration of the submaps itself: the paper's alignment factor
  scan,     ///< the scan to the submap (released); if that refuses, the frames are joined without a measurement
};

/// When sessions are merged.
struct MergeOptions {
  bool enabled = true;      ///< whether sessions are merged at all
  double min_travel = 4.0;  ///< metres along the path between two attempts
  double min_period = 0;    ///< seconds of the data between two attempts
  /// Keyframes n: up to 2n+1 of the earlier session, n+1 of the current one, which has no future.
  Index submap_radius = 20;
  double submap_length = 60;  ///< metres along the path on each side, at most; 0: any (the paper)
  double voxel_size = 1.0;    ///< metres, of both submaps
  /// Inliers over target points (tau_R), and over matched features, of a registration that did not verify its pose. Of
  /// half submaps of four real sensors sought in whole ones, 101 of 102 right poses meet both, and none of 474 wrong
  /// ones.
  double min_fitness = 0.30;
  double min_putative = 0.05;     ///< consensus over matches, at least
  double min_source_fitness = 0;  ///< inliers over source points (released: 0.5, by Open3D 0.15.1, which it builds)
  double min_translation = 0;     ///< metres and
  double min_rotation = 0;  ///< radians: frames that lie nearer together than both are not joined (released: 1, 0.035)
  MergeMeasurement measurement = MergeMeasurement::refined;  ///< what joins the frames
  double lambda = 1e-4;  ///< of `submaps`: variance, m^2 and rad^2, over the inliers' mean squared distance (the paper)
  Index confirmations = 2;         ///< places that have to agree before the frames are joined (the paper: 1)
  double apart = 10.0;             ///< metres along the path between two such places
  double agree_translation = 2.0;  ///< metres that two places may differ by,
  double agree_per_metre = 0.02;   ///< and metres for each metre of the path between them
  double agree_rotation = 0.1;     ///< radians
  /// What fixes contradict is not joined; and one place is enough if they agree with it, each session along its whole
  /// way, and so many scans around the place do, a quarter as far off as two places may be. 0: one place never is.
  FixEvidenceOptions fixes{};
  Index witnesses = 3;  ///< scans around the place that have to agree with it
};

}  // namespace chainslam
