#include "presets.hpp"

namespace chainslam::mapper {

namespace {

constexpr double any = 1e9;  ///< of a bound that asks for nothing

/// Section 5 and 6 of the paper, with the parameters of its released configurations.
void apply_paper(BackEndParts& parts) {
  parts.candidates = {.radius = 15.0, .heading_weight = 0, .min_separation = 1, .max_count = 1};
  parts.closures.min_travel = 16.0;  // v / f_lc > r_lc keeps the components of the adjacency graph apart
  parts.closures.gate = {.max_mean_squared_error = 0.3,
                         .max_residual = any,
                         .min_inlier_ratio = 0,
                         .max_translation = any,
                         .max_rotation = any};
  parts.closures.submap.radius = 20;
  parts.closures.submap.voxel_size = 0.4;
  parts.registration.method = ClosureMethod::point_to_point;
  parts.noise.from_hessian = false;
  parts.noise.isotropic.lambda = 1e-4;
  parts.chain = {.through_current_session = true,
                 .reach = 0,
                 .guess_through_chain = false,
                 .max_distance = 0,
                 .min_separation = 0,
                 .max_alignments = 0,
                 .max_translation = 0,
                 .correlation = 0};
  parts.gnss.radius = 10.0;
  parts.gnss.max_count = 1;
  parts.merge.min_travel = 0;
  parts.merge.min_putative = 0;
  parts.merge.refine = false;
  parts.merge.confirmations = 1;
  parts.back_end.recheck_travel = parts.closures.min_travel;
  parts.back_end.graph.odometry_noise = {
      .translation = 1e-2, .translation_per_metre = 0, .rotation = 1e-3, .rotation_per_metre = 0};
  parts.back_end.graph.anchor = 1e-6;  // variance 1e-12
  parts.back_end.graph.anchor_joined_sessions = true;
  parts.kernel.width = any;  // none
}

/// Where the released code departs from the paper.
void apply_released(BackEndParts& parts) {
  apply_paper(parts);
  parts.registration.point_to_point.max_distance = 150.0;  // so all points are in the score
  parts.chain.through_current_session = false;
  parts.chain.max_alignments = 200;  // the code has no bound; this one only keeps a run finite
  parts.features.normals.radius = 4.0;
  parts.merge.min_fitness = 0;
  parts.merge.min_putative = 0.5;
  parts.merge.min_translation = 1.0;
  parts.merge.min_rotation = 0.035;  // 0.05 in the Frobenius norm
  parts.back_end.chain_in_recheck = false;
  parts.back_end.graph.remeasure_loaded = true;
}

}  // namespace

void apply(Preset preset, BackEndParts& parts) {
  parts = {};
  if (preset == Preset::paper) apply_paper(parts);
  if (preset == Preset::released) apply_released(parts);
}

void apply(Platform platform, Preset preset, KeyframeOptions& keyframes, BackEndParts& parts) {
  const bool mars = platform == Platform::mars;
  keyframes.distance = mars ? 10.0 : 3.0;
  keyframes.angle = 0.2;
  parts.candidates.min_interval = seconds(mars ? 60.0 : 30.0);
  if (preset == Preset::best) return;
  // MARS: 10 m/s at 0.4 Hz. NCLT: 1.2 m/s at 0.3 Hz in the released code, which fuses components; the paper's rule
  // asks for more than r_lc.
  parts.closures.min_travel = mars ? 25.0 : preset == Preset::released ? 4.0 : 16.0;
  parts.back_end.recheck_travel = parts.closures.min_travel;
}

}  // namespace chainslam::mapper
