#include "back_end_options.hpp"

#include <array>
#include <numbers>
#include <string>
#include <string_view>

namespace chainslam::mapper {

namespace {

using support::Configuration;

constexpr double radians_a_degree = std::numbers::pi / 180;

void add_point_to_point(Configuration& configuration, Icp<PointToPoint>& icp) {
  const std::string of = " By method = point_to_point.";
  configuration.add("closures.max_distance", icp.max_distance,
                    {.unit = "m", .min = 0.01, .max = 1000, .help = "Between matched points." + of});
  configuration.add("closures.max_iterations", icp.max_iterations,
                    {.min = 1, .max = 100000, .help = "Steps of an alignment." + of});
  configuration.add("closures.pilot", icp.pilot,
                    {.min = 1,
                     .max = 1000,
                     .help = "The first steps look at one point of so many. 1: there are no such steps." + of});
  configuration.add("closures.min_overlap", icp.min_overlap,
                    {.min = 0, .max = 1, .help = "Least share of the scan's points with a match." + of});
  configuration.add("closures.degeneracy_threshold", icp.degeneracy_threshold,
                    {.min = 0,
                     .max = 1,
                     .help = "Directions told by less, a mean squared cosine, are left as guessed. 0: none is." + of});
  configuration.add("closures.translation_tolerance", icp.translation_tolerance,
                    {.unit = "m", .min = 0, .max = 1, .help = "An alignment ends with a step shorter than this" + of});
  configuration.add("closures.rotation_tolerance", icp.rotation_tolerance,
                    {.unit = "deg", .min = 0, .max = 10, .factor = radians_a_degree, .help = "and than this," + of});
  configuration.add("closures.cost_tolerance", icp.cost_tolerance,
                    {.min = 0, .max = 1, .help = "or with one that changes the mean cost by a smaller share." + of});
}

void add_closures(Configuration& configuration, BackEndParts& parts) {
  ProximityCandidates& candidates = parts.candidates;
  ClosureGate& gate = parts.closures.gate;
  configuration.add("closures.radius", candidates.radius,
                    {.unit = "m", .min = 0, .max = 1000, .help = "Keyframes so near are tried. 0: no closures."});
  configuration.add("closures.heading_weight", candidates.heading_weight,
                    {.unit = "m/rad",
                     .min = 0,
                     .max = 1000,
                     .help = "Of two candidates the nearer is tried first; a turn between two counts as so much way."});
  configuration.add(
      "closures.min_interval", candidates.min_interval,
      {.unit = "s", .min = 0, .max = 1e6, .help = "Keyframes of the same session are tried after so long."});
  configuration.add("closures.max_candidates", candidates.max_count,
                    {.min = 1, .max = 1000, .help = "Keyframes tried for one scan at most."});
  configuration.add(
      "closures.min_travel", parts.closures.min_travel,
      {.unit = "m", .min = 0, .max = 1e6, .help = "Way between two searches. 0: every keyframe searches."});
  configuration.add(
      "closures.min_period", parts.closures.min_period,
      {.unit = "s", .min = 0, .max = 1e6, .help = "Time of the data between two searches. 0: the way alone decides."});
  configuration.add(
      "closures.max_alignments", parts.back_end.max_alignments,
      {.min = 0,
       .max = 1000000,
       .help = "Alignments after which the searches along a merged or corrected session wait for the next "
               "keyframe. 0: all are made at once."});
  configuration.add("closures.before_merge", parts.back_end.close_before_merge,
                    {.help = "Whether a session that follows others closes loops before it is joined to one of them."});
  configuration.add(
      "closures.submap_radius", parts.closures.submap.radius,
      {.min = 0, .max = 1000, .help = "Keyframes on each side of the candidate that make up its submap."});
  configuration.add("closures.submap_length", parts.closures.submap.max_length,
                    {.unit = "m",
                     .min = 0,
                     .max = 1e6,
                     .help = "Path on each side of the candidate that its submap reaches at most. 0: as many keyframes "
                             "as stated."});
  configuration.add("closures.submap_fragment", parts.closures.submap.fragment,
                    {.min = 1,
                     .max = 1000,
                     .help = "Consecutive keyframes whose scans are put together once, and which share a submap. 1: "
                             "each has its own."});
  configuration.add("closures.voxel_size", parts.closures.submap.voxel_size,
                    {.unit = "m", .min = 0.02, .max = 10, .help = "Edge of a submap's voxels."});
  configuration.add("closures.scan_voxel", parts.closures.scan_voxel,
                    {.unit = "m",
                     .min = 0,
                     .max = 10,
                     .help = "Edge of the voxels of the scan that is aligned. 0: as the keyframe keeps it."});
  configuration.add(
      "closures.method", parts.registration.method,
      {{"point_to_plane", ClosureMethod::point_to_plane}, {"point_to_point", ClosureMethod::point_to_point}},
      {.help = "How scans are aligned to submaps: coarse to fine on planes, or the paper's."});
  add_point_to_point(configuration, parts.registration.point_to_point);
  configuration.add("closures.take_iteration_limit", gate.take_iteration_limit,
                    {.help = "Whether an alignment that was still moving after its last step will do."});
  configuration.add("closures.noise_from_hessian", parts.noise.from_hessian,
                    {.help = "Covariance from the alignment's Hessian; else lambda times its mean squared error."});
  configuration.add("closures.lambda", parts.noise.isotropic.lambda,
                    {.min = 1e-12, .max = 1e6, .help = "Variance over mean squared error, if not from the Hessian."});
  configuration.add("closures.least_variance", parts.noise.isotropic.least,
                    {.unit = "m^2, rad^2", .min = 1e-15, .max = 1, .help = "The least, if not from the Hessian."});
  configuration.add(
      "closures.max_misfit", gate.max_misfit,
      {.min = 0,
       .max = 1e9,
       .help = "How many times more than the submap's own points the scan's lie off its surfaces, over the "
               "share that lies near any. 0: not looked at."});
  configuration.add(
      "closures.by_direction", gate.by_direction,
      {.help = "Whether that is asked of each of three directions by the surfaces that tell it, or of all "
               "points at once."});
  configuration.add("closures.max_mean_squared_error", gate.max_mean_squared_error,
                    {.unit = "m^2",
                     .min = 0,
                     .max = 1e9,
                     .help = "Of the distances to nearest points, over inliers. 0: not looked at."});
  configuration.add("closures.min_inlier_ratio", gate.min_inlier_ratio,
                    {.min = 0, .max = 1, .help = "Share of the scan's points with a partner in the submap."});
  configuration.add("closures.max_translation", gate.max_translation,
                    {.unit = "m", .min = 0, .max = 1e9, .help = "Corrections larger than this are not believed."});
  configuration.add("closures.max_rotation", gate.max_rotation,
                    {.unit = "deg",
                     .min = 0,
                     .max = 1e12,
                     .factor = radians_a_degree,
                     .help = "Corrections larger than this are not believed."});
  configuration.add("closures.outlier_threshold", parts.outliers.closures,
                    {.min = 0,
                     .max = 1e9,
                     .help = "Squared error, in variances, beyond which the graph leaves a closure out; 0: never."});
  configuration.add("closures.search_again", parts.back_end.search_again,
                    {.unit = "m",
                     .min = 0,
                     .max = 1e6,
                     .help = "Keyframes that the graph moves farther than this are tried again; 0: none."});
}

void add_chain(Configuration& configuration, BackEndParts& parts) {
  ChainOptions& chain = parts.chain;
  configuration.add("chain.enabled", chain.enabled,
                    {.help = "Whether direct closures with earlier sessions are chained."});
  configuration.add("chain.through_current_session", chain.through_current_session,
                    {.help = "Whether the search walks through the current session's keyframes too."});
  configuration.add(
      "chain.reach", chain.reach,
      {.min = 0, .max = 1000, .help = "Keyframes on each side of the partner whose closures count as its."});
  configuration.add("chain.guess_through_chain", chain.guess_through_chain,
                    {.help = "Whether alignments start from the direct closure; else from the graph's estimate."});
  configuration.add("chain.max_distance", chain.max_distance,
                    {.unit = "m", .min = 0, .max = 1e6, .help = "Farther keyframes are not tried. 0: all are."});
  configuration.add("chain.min_separation", chain.min_separation,
                    {.min = 0, .max = 100000, .help = "Keyframes between two that are tried in one session."});
  configuration.add("chain.max_alignments", chain.max_alignments,
                    {.min = 0, .max = 1000000, .help = "Alignments for one direct closure. 0: no bound."});
  configuration.add("chain.max_translation", chain.max_translation,
                    {.unit = "m", .min = 0, .max = 1e6, .help = "More contradicts the chain. 0: nothing does."});
  configuration.add(
      "chain.max_rotation", chain.max_rotation,
      {.unit = "deg", .min = 0, .max = 180, .factor = radians_a_degree, .help = "More contradicts the chain."});
  configuration.add(
      "chain.correlation", chain.correlation,
      {.min = 0, .max = 1, .help = "Of closures that share a scan: 0 counts each in full, 1 all as one."});
}

void add_merge_registration(Configuration& configuration, MergeRegistration& merging) {
  configuration.add(
      "merge.method", merging.method, {{"verified", MergeMethod::verified}, {"features", MergeMethod::features}},
      {.help = "How submaps are aligned. verified: the poses that most matches of features allow together "
               "are refined and checked by the submaps themselves. features: the paper's RANSAC; the "
               "keys from normal_radius to min_source_fitness are its own."});
  Verifier& check = merging.verified.check;
  configuration.add(
      "merge.max_plane_rmse", check.max_plane_rmse,
      {.unit = "m",
       .min = 0,
       .max = 100,
       .help = "Root mean square of a submap's distances from the other's planes, by method = verified."});
  configuration.add("merge.min_aligned_normals", check.min_aligned_normals,
                    {.min = 0, .max = 1, .help = "Share of normals that agree to 45 degrees, by method = verified."});
  configuration.add("merge.min_overlap", check.min_overlap,
                    {.min = 0, .max = 1, .help = "Share of the smaller submap on the other, by method = verified."});
  FeatureRegistration<>& features = merging.features;
  configuration.add("merge.normal_radius", features.normals.radius,
                    {.unit = "m", .min = 0.05, .max = 100, .help = "Farthest neighbours that a normal is fitted to."});
  configuration.add("merge.normal_neighbors", features.normals.neighbors,
                    {.min = 5, .max = 1000, .help = "Neighbours that a normal is fitted to at most."});
  configuration.add("merge.feature_radius", features.features.radius,
                    {.unit = "m", .min = 0.1, .max = 100, .help = "Farthest neighbours that a feature describes."});
  configuration.add("merge.feature_neighbors", features.features.max_neighbors,
                    {.min = 2, .max = 10000, .help = "Neighbours that a feature describes at most."});
  Ransac& ransac = features.estimator;
  configuration.add(
      "merge.edge_length_ratio", ransac.edge_length_ratio,
      {.min = 0, .max = 1, .help = "Least ratio of the edges of two triangles of points that are taken as the same."});
  configuration.add("merge.max_distance", ransac.max_distance,
                    {.unit = "m", .min = 0.01, .max = 100, .help = "Of matched points that agree; of inliers."});
  configuration.add("merge.max_iterations", ransac.max_iterations,
                    {.min = 1, .max = 10000000, .help = "Triples of matches that are tried at most."});
  configuration.add("merge.confidence", ransac.confidence,
                    {.min = 0.01, .max = 0.999999, .help = "That a right triple was among them, for ending early."});
  configuration.add("merge.min_consensus", ransac.min_consensus,
                    {.min = 3, .max = 100000, .help = "Matches that must agree."});
}

void add_merge(Configuration& configuration, BackEndParts& parts) {
  MergeOptions& merge = parts.merge;
  configuration.add("merge.enabled", merge.enabled, {.help = "Whether sessions are joined into one frame."});
  configuration.add("merge.gnss_radius", parts.gnss.radius,
                    {.unit = "m", .min = 0, .max = 10000, .help = "Keyframes whose fixes are so near are tried."});
  configuration.add("merge.gnss_with_height", parts.gnss.with_height,
                    {.help = "Whether that distance is one in space; else along the ground."});
  configuration.add("merge.gnss_max_height", parts.gnss.max_height,
                    {.unit = "m", .min = 0, .max = 1e9, .help = "Largest difference in height of the two fixes."});
  configuration.add(
      "merge.gnss_max_sigma", parts.gnss.max_sigma,
      {.unit = "m", .min = 0, .max = 1e9, .help = "Fixes that state a larger standard deviation are not used."});
  configuration.add("merge.max_candidates", parts.gnss.max_count,
                    {.min = 1, .max = 1000, .help = "Keyframes tried for one keyframe at most."});
  configuration.add("merge.min_travel", merge.min_travel,
                    {.unit = "m", .min = 0, .max = 1e6, .help = "Way between two attempts."});
  configuration.add("merge.min_period", merge.min_period,
                    {.unit = "s", .min = 0, .max = 1e6, .help = "Time of the data between two attempts."});
  configuration.add("merge.submap_radius", merge.submap_radius,
                    {.min = 0,
                     .max = 1000,
                     .help = "Keyframes on each side that make up the earlier submap, and before of the current one."});
  configuration.add("merge.voxel_size", merge.voxel_size,
                    {.unit = "m", .min = 0.05, .max = 10, .help = "Edge of the voxels of both submaps."});
  configuration.add("merge.submap_length", merge.submap_length,
                    {.unit = "m",
                     .min = 0,
                     .max = 1e6,
                     .help = "Way on each side that a submap reaches at most. 0: as many keyframes as stated."});
  add_merge_registration(configuration, parts.merging);
  configuration.add("merge.min_fitness", merge.min_fitness,
                    {.min = 0, .max = 1, .help = "Inliers over target points (tau_R)."});
  configuration.add("merge.min_putative", merge.min_putative,
                    {.min = 0, .max = 1, .help = "Inliers over matched features."});
  configuration.add("merge.min_source_fitness", merge.min_source_fitness,
                    {.min = 0, .max = 1, .help = "Inliers over points of the current submap."});
  configuration.add("merge.min_translation", merge.min_translation,
                    {.unit = "m", .min = 0, .max = 1e6, .help = "Frames that lie nearer together than this and"});
  configuration.add(
      "merge.min_rotation", merge.min_rotation,
      {.unit = "deg", .min = 0, .max = 180, .factor = radians_a_degree, .help = "are turned by less are not joined."});
  configuration.add("merge.measurement", merge.measurement,
                    {{"refined", MergeMeasurement::refined},
                     {"submaps", MergeMeasurement::submaps},
                     {"scan", MergeMeasurement::scan}},
                    {.help = "What measures the closure that joins two sessions. refined: an alignment of the scan to "
                             "the submap, which must accept the place too. submaps: their registration. scan: that "
                             "alignment; if it refuses, nothing does, and the sessions are joined all the same."});
  configuration.add("merge.lambda", merge.lambda,
                    {.min = 1e-12, .max = 1e6, .help = "Variance over mean squared error, by measurement = submaps."});
  configuration.add("merge.confirmations", merge.confirmations,
                    {.min = 1, .max = 1000, .help = "Places that must agree before sessions are joined."});
  configuration.add("merge.apart", merge.apart,
                    {.unit = "m", .min = 0, .max = 1e6, .help = "Way between two such places."});
  configuration.add("merge.witnesses", merge.witnesses,
                    {.min = 0,
                     .max = 20,
                     .help = "Scans around one place that suffice to join sessions there, if the fixes of both agree "
                             "with it. 0: one place never suffices."});
  configuration.add("merge.fixes_apart", merge.fixes.apart,
                    {.unit = "m",
                     .min = 0,
                     .max = 1e6,
                     .help = "Distance by which the GNSS fixes of two sessions may differ, in the median. Beyond twice "
                             "that they contradict a merge. 0: they are not asked."});
  configuration.add("merge.misplaced", parts.gnss.misplaced,
                    {.unit = "m",
                     .min = 0,
                     .max = 1e9,
                     .help = "Distance in the map, beyond merge.gnss_radius, of keyframes that are tried because GNSS "
                             "puts them near each other."});
  configuration.add("merge.chained", parts.back_end.chain_merges,
                    {.help = "Whether the closure that joins two sessions is chained, as direct ones are."});
  configuration.add("merge.recheck_travel", parts.back_end.recheck_travel,
                    {.unit = "m", .min = 0, .max = 1e6, .help = "Way between searches along a joined session."});
  configuration.add("merge.recheck_pause", parts.back_end.recheck_pause,
                    {.min = 0, .max = 1000, .help = "Keyframes that are left out there after one that was found."});
  configuration.add("merge.recheck_chained", parts.back_end.chain_in_recheck,
                    {.help = "Whether what these searches find is chained."});
}

void add_gnss(Configuration& configuration, GnssFactorOptions& gnss) {
  configuration.add("graph.gnss", gnss.enabled, {.help = "Whether GNSS fixes hold the map."});
  constexpr std::array<std::string_view, 3> axes{"graph.gnss_antenna_x", "graph.gnss_antenna_y",
                                                 "graph.gnss_antenna_z"};
  for (int axis = 0; axis < 3; ++axis)
    configuration.add(std::string(axes[static_cast<std::size_t>(axis)]), gnss.antenna[axis],
                      {.unit = "m", .min = -100, .max = 100, .help = "Position of the antenna in the body."});
  configuration.add("graph.gnss_bias", gnss.bias,
                    {.unit = "m", .min = 0, .max = 1e4, .help = "Error of a fix beyond what it says of itself."});
  configuration.add("graph.gnss_correlated", gnss.correlated,
                    {.min = 1, .max = 1e6, .help = "Fixes one after another that err together and count as one."});
  configuration.add("graph.gnss_outlier_threshold", gnss.threshold,
                    {.min = 0.1, .max = 1e9, .help = "Squared error, in variances, beyond which a fix is left out."});
}

/// Which fixes are used, and when they suffice to place a frame on the Earth.
void add_fixes(Configuration& configuration, GnssFactorOptions& gnss) {
  configuration.add(
      "graph.gnss_max_sigma", gnss.max_sigma,
      {.unit = "m", .min = 0, .max = 1e9, .help = "Fixes that state a larger standard deviation are not used."});
  configuration.add("graph.gnss_least_fixes", gnss.least_fixes,
                    {.min = 3, .max = 1000000, .help = "Minimum number of fixes before a frame is georeferenced."});
  configuration.add("graph.gnss_least_spread", gnss.least_spread,
                    {.unit = "m",
                     .min = 0,
                     .max = 1e6,
                     .help = "Minimum root mean square spread of these fixes across their main direction."});
}

void add_submap_memory(Configuration& configuration, SubmapOptions& submap) {
  constexpr double mebibyte = 1 << 20;
  configuration.add("closures.submap_memory", submap.max_bytes,
                    {.unit = "MiB",
                     .min = 1,
                     .max = 1e6,
                     .factor = mebibyte,
                     .help = "Maximum memory of submaps that are kept for reuse. The least recently used are dropped "
                             "first; what the map becomes does not depend on it."});
}

void add_graph(Configuration& configuration, MapGraphOptions& graph) {
  OdometryNoise& noise = graph.odometry_noise;
  configuration.add("graph.odometry_translation", noise.translation,
                    {.unit = "m", .min = 1e-6, .max = 100, .help = "Standard deviation of a step between keyframes,"});
  configuration.add("graph.odometry_translation_per_metre", noise.translation_per_metre,
                    {.min = 0, .max = 1, .help = "and what each metre of the way adds."});
  configuration.add(
      "graph.odometry_rotation", noise.rotation,
      {.unit = "deg", .min = 1e-6, .max = 100, .factor = radians_a_degree, .help = "The same for the rotation,"});
  configuration.add(
      "graph.odometry_rotation_per_metre", noise.rotation_per_metre,
      {.unit = "deg/m", .min = 0, .max = 10, .factor = radians_a_degree, .help = "what each metre adds,"});
  configuration.add("graph.odometry_rotation_per_radian", noise.rotation_per_radian,
                    {.min = 0, .max = 1, .help = "and each radian turned, radians."});
  configuration.add("graph.odometry_stated_translation", noise.stated_translation,
                    {.min = 0,
                     .max = 100,
                     .help = "How much of the deviations that odometry itself states of frames' positions counts,"});
  configuration.add("graph.odometry_stated_rotation", noise.stated_rotation,
                    {.min = 0, .max = 100, .help = "and of their rotations."});
  OdometryNoise& unknown = graph.unknown_odometry;
  configuration.add("graph.odometry_unknown_translation", unknown.translation,
                    {.unit = "m",
                     .min = 1e-6,
                     .max = 100,
                     .help = "Standard deviation of a step of recorded odometry that says nothing of its errors,"});
  configuration.add("graph.odometry_unknown_translation_per_metre", unknown.translation_per_metre,
                    {.min = 0, .max = 1, .help = "and what each metre of the way adds."});
  configuration.add(
      "graph.odometry_unknown_rotation", unknown.rotation,
      {.unit = "deg", .min = 1e-6, .max = 100, .factor = radians_a_degree, .help = "The same for the rotation,"});
  configuration.add(
      "graph.odometry_unknown_rotation_per_metre", unknown.rotation_per_metre,
      {.unit = "deg/m", .min = 0, .max = 10, .factor = radians_a_degree, .help = "and what each metre adds."});
  configuration.add("graph.odometry_doubt", graph.odometry_doubt.enabled,
                    {.help = "Whether steps count for less where scans between were lost or saw too little."});
  configuration.add("graph.anchor", graph.anchor,
                    {.min = 1e-9,
                     .max = 1,
                     .help = "Standard deviation, metres and radians, by which the start of a frame is held."});
  configuration.add("graph.anchor_joined_sessions", graph.anchor_joined_sessions,
                    {.help = "Whether a joined session's start is held where the merge put it."});
  configuration.add("graph.remeasure_loaded", graph.remeasure_loaded,
                    {.help = "Whether a loaded map's measurements are replaced by what its poses say."});
  configuration.add("graph.max_iterations", graph.optimizer.max_iterations,
                    {.min = 1, .max = 100000, .help = "Steps of one optimisation."});
}

}  // namespace

void add_back_end(Configuration& configuration, BackEndParts& parts) {
  add_closures(configuration, parts);
  add_chain(configuration, parts);
  add_merge(configuration, parts);
  add_graph(configuration, parts.back_end.graph);
  configuration.add("graph.odometry_outlier_threshold", parts.outliers.odometry,
                    {.min = 0,
                     .max = 1e9,
                     .help = "The same of a step of odometry, where closures or fixes agree against it; 0: never."});
  add_gnss(configuration, parts.back_end.graph.gnss);
  add_fixes(configuration, parts.back_end.graph.gnss);
  add_submap_memory(configuration, parts.closures.submap);
}

}  // namespace chainslam::mapper
