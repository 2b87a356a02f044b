#pragma once

#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/smoother_reports.hpp"
#include "chainslam/slam/georeference.hpp"
#include "chainslam/slam/gravity_measurement.hpp"
#include "chainslam/slam/odometry_noise.hpp"

namespace chainslam {

/// What fixes say for and against a merge.
struct FixEvidenceOptions {
  double max_difference = 10.0;  ///< metres that fixes of two sessions may differ by; 0: they are not asked
  double contradiction = 2.0;    ///< times as much, in the median, contradicts
  Index min_fixes = 10;          ///< of each part
  double min_spread = 15.0;      ///< metres (rms) along its main direction
  double max_sigma = 20.0;       ///< metres: fixes that state more are not used
};

/// What measures a merge's closure, once the submaps are aligned.
enum class MergeMeasurement {
  refined,  ///< alignment of the scan to the submap, which must accept the place too
  submaps,  ///< the registration of the submaps itself: the paper's alignment factor
  scan,     ///< the scan to the submap (released); if that refuses, the frames are joined without a measurement
};

/// When sessions are merged.
struct MergeOptions {
  bool enabled = true;          ///< whether sessions are merged at all
  double min_travel = 4.0;      ///< metres along the path between two attempts
  double min_period = 0;        ///< seconds of the data between two attempts
  Index max_registrations = 1;  ///< candidates that one attempt tries, the others wait for the next; 0: all (the paper)
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
  Index confirmations = 2;           ///< places that have to agree before the frames are joined (the paper: 1)
  double min_place_distance = 10.0;  ///< metres along the path between two such places
  double agree_translation = 2.0;    ///< metres that two places may differ by,
  double agree_per_metre = 0.02;     ///< and metres for each metre of the path between them
  double agree_rotation = 0.1;       ///< radians
  /// What fixes contradict is not joined; and one place is enough if they agree with it, each session along its whole
  /// way, and so many scans around the place do, a quarter as far off as two places may be. 0: one place never is.
  FixEvidenceOptions fixes{};
  Index supporting_scans = 3;  ///< scans around the place that have to agree with it
};

/// Of the pose graph over the keyframes.
struct MapGraphOptions {
  OdometryNoise odometry_noise{};                             ///< what odometry's measurements weigh
  OdometryNoise unknown_odometry = unknown_odometry_noise();  ///< where frames have no covariance, as recorded ones
  OdometryInflation odometry_inflation{};  ///< where frames between two keyframes were lost or degenerate
  /// Standard deviation of the prior that holds a frame's first keyframe, metres and radians.
  double anchor = 1e-4;
  /// Whether a session that a merge joins to another frame is held there, at its aligned start, by a prior as tight
  /// (the paper); else closures alone tie it to the others.
  bool anchor_joined_sessions = false;
  /// Whether measurements of a loaded map, and of sessions before the one that begins, are replaced by what their poses
  /// say, as by the released code, which saves and loads each: no residuals are left, and what is known counts twice.
  bool remeasure_loaded = false;
  GnssFactorOptions gnss{};        ///< for `GroupGnc`
  GravityFactorOptions gravity{};  ///< for `GroupGnc`
  /// How near each optimization comes to the optimum: its tolerances move a residual by a twentieth of its usual size.
  /// Maps are as accurate as with a hundredth of them, before the last optimization and after it. Without patience,
  /// since it goes on until nothing waits, and without a lag, since closures may reach any keyframe.
  SmootherOptions smoother{.linear_tolerance = 2e-3, .nonlinear_tolerance = 3e-3, .patience = 0.0};
  /// How near the last one does. Its iterations also bound the updates of the others.
  ConvergeOptions<NoRestart> optimizer{.max_iterations = 50, .relative_tolerance = 1e-6};
  /// Multiplications of factorizations after which an optimization leaves what still waits to be relinearized to the
  /// next one: it bounds the time of an optimization.
  double largest_work = 1e8;
};

/// What the back end does besides finding closures.
struct BackEndOptions {
  MapGraphOptions graph{};  ///< of the pose graph
  /// After a merge, metres along the aligned path between two keyframes that are tried again (section 6 of the paper).
  double recheck_travel = 4.0;
  Index fixes_at_once = 10;  ///< GNSS fixes that wait before they make an optimization of their own
  /// Direct closures that wait before they make one, each with what is chained to it; 1: each does (the paper).
  Index closures_at_once = 10;
  double small_correction = 0.1;  ///< metres; one that moves its scan, or a point 10 m from it, by more does not wait
  /// Metres that a keyframe of the current session is moved by before it is tried again: its neighbours are others now.
  double search_again = 3.0;
  /// Scans that a keyframe aligns, until what is left to search again waits for the next one; 0: any number (the
  /// paper).
  Index max_alignments = 4;
  Index recheck_pause = 0;       ///< keyframes that are passed over after one that was found (released: 4)
  bool chain_in_recheck = true;  ///< the released code does not
  bool chain_merges = false;     ///< whether what joins two frames is chained, as direct closures are
  /// Whether a session that follows others closes loops before it is joined to one of them; the released code does not.
  bool close_before_merge = true;
};

/// What the back end did so far.
struct BackEndCounts {
  Index optimizations = 0;         ///< of the graph
  Index failed_optimizations = 0;  ///< the estimates before were kept
  Index merges = 0;                ///< frames joined
  Index reverted = 0;              ///< times that closures were withdrawn, or frames parted again
  Index alignments = 0;            ///< scans aligned to submaps, accepted or not; without those that confirm a merge
  UpdateReport last;               ///< of the last one, but for the one that finishes
  ConvergeReport end;              ///< of the one that finishes
};

}  // namespace chainslam
