#pragma once

#include <map>
#include <span>
#include <vector>

#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/batch_optimizer.hpp"
#include "chainslam/factor_graph/factor_graph.hpp"
#include "chainslam/factor_graph/factors.hpp"
#include "chainslam/lie/se3.hpp"
#include "drive.hpp"
#include "loop_search.hpp"

namespace chainslam::lamm {

/// LAMM's pose graph. Variances are of all six coordinates, m^2 and rad^2.
struct ScanGraphOptions {
  double odometry_variance = 1e-6;  ///< of the step from one frame to the next
  double loop_variance = 0.1;
  double loop_kernel = 1.0;       ///< Cauchy's width, in standard deviations
  double prior_variance = 1e-12;  ///< of the first frame of each group of drives
  /// Factors of one loop: its ends; or as released, none between these, but between each of so many frames after one
  /// end and the frame as far after the other, all with the relative pose of the ends.
  Index frames_a_loop = 0;
  bool placed = true;     ///< whether drives start where a loop puts them; else each in its own frame
  bool own_start = true;  ///< whether a group is held at its first frame; else, as released, at frame `group`
                          ///< of the first drive
  Index max_iterations = 100;
  bool damped = true;  ///< Levenberg-Marquardt; else Gauss-Newton, as iSAM2
};

/// What came of it.
struct OptimizedDrives {
  std::vector<std::vector<SE3d>> poses;  ///< T_map_body of each scan of each drive
  std::vector<Index> frame_of;           ///< of each drive, the first drive of its group: the one in whose frame it is
  OptimizeReport report;
  Index variables = 0;
  Index factors = 0;
};

/// Optimizes all drives that loops connect, together.
/// @param loops  those that are not `kept` are passed over.
[[nodiscard]] OptimizedDrives optimize_drives(std::span<const Drive> drives, std::span<const Loop> loops,
                                              const ScanGraphOptions& options);

/// The covariance of the pose of frame `to` relative to frame `from`, if each step between frames has this variance in
/// all six coordinates; tangent [translation; rotation].
[[nodiscard]] Matrix6d compounded_covariance(const Drive& drive, Index from, Index to, double variance);

}  // namespace chainslam::lamm
