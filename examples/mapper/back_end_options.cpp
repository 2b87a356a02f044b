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
  const std::string of = " Requires method = point_to_point.";
  configuration.add("closures.max_distance", icp.max_distance,
                    {.unit = "m", .min = 0.01, .max = 1000, .help = "Maximum distance between matched points." + of});
  configuration.add("closures.max_iterations", icp.max_iterations,
                    {.min = 1, .max = 100000, .help = "Maximum number of ICP iterations." + of});
  configuration.add("closures.coarse_stride", icp.coarse_stride,
                    {.min = 1,
                     .max = 1000,
                     .help = "The initial iterations use every n-th source point. 1: no coarse iterations." + of});
  configuration.add("closures.min_overlap", icp.min_overlap,
                    {.min = 0, .max = 1, .help = "Minimum share of the scan's points with a match." + of});
  configuration.add("closures.degeneracy_threshold", icp.degeneracy_threshold,
                    {.min = 0,
                     .max = 1,
                     .help = "Directions with a smaller mean squared cosine are unobservable and kept from the initial "
                             "guess. 0: none is." +
                             of});
  configuration.add("closures.translation_tolerance", icp.translation_tolerance,
                    {.unit = "m",
                     .min = 0,
                     .max = 1,
                     .help = "An alignment has converged when both the translation and the rotation of a step are "
                             "below their tolerances." +
                             of});
  configuration.add("closures.rotation_tolerance", icp.rotation_tolerance,
                    {.unit = "deg",
                     .min = 0,
                     .max = 10,
                     .factor = radians_a_degree,
                     .help = "Rotation tolerance of convergence; see translation_tolerance." + of});
  configuration.add(
      "closures.cost_tolerance", icp.cost_tolerance,
      {.min = 0,
       .max = 1,
       .help = "An alignment has also converged when a step changes the mean cost by a smaller fraction." + of});
}

void add_closures(Configuration& configuration, BackEndParts& parts) {
  ProximityCandidates& candidates = parts.candidates;
  ClosureGate& gate = parts.closures.gate;
  configuration.add("closures.radius", candidates.radius,
                    {.unit = "m", .min = 0, .max = 1000, .help = "Search radius for loop candidates. 0: no closures."});
  configuration.add("closures.start_spacing", parts.closures.starts.spacing,
                    {.unit = "m",
                     .min = 0.1,
                     .max = 1000,
                     .help = "Spacing of the initial guesses from which a rejected alignment is repeated."});
  configuration.add("closures.start_distance", parts.closures.starts.max_distance,
                    {.unit = "m",
                     .min = 0,
                     .max = 1000,
                     .help = "Maximum distance of these guesses from the pose in the graph. 0: no repetition."});
  configuration.add("closures.start_patience", parts.closures.starts.patience,
                    {.min = 0,
                     .max = 1000000,
                     .help = "Number of consecutive unsuccessful searches after which guesses in all horizontal "
                             "directions are tried."});
  configuration.add(
      "closures.start_points", parts.closures.starts.points,
      {.min = 0,
       .max = 1000000,
       .help = "Minimum number of the scan's points by which these guesses are compared. 0: all points."});
  configuration.add(
      "closures.max_places", parts.closure_places,
      {.min = 0,
       .max = 1000,
       .help =
           "Maximum number of places, found by what their scans look like from above, that are tried for a keyframe "
           "where nothing near closes the loop. 0: none. See also merge.place_length."});
  configuration.add("closures.heading_weight", candidates.heading_weight,
                    {.unit = "m/rad",
                     .min = 0,
                     .max = 1000,
                     .help = "Ranks candidates by distance plus this weight times the difference in heading."});
  configuration.add("closures.min_interval", candidates.min_interval,
                    {.unit = "s",
                     .min = 0,
                     .max = 1e6,
                     .help = "Minimum time between two keyframes of the same session that form a closure."});
  configuration.add(
      "closures.min_keyframes", candidates.min_keyframes,
      {.min = 0,
       .max = 1000000,
       .help = "Minimum number of keyframes between two keyframes of the same session that form a closure, "
               "so that the submap does not contain the aligned scan; see also min_path."});
  configuration.add("closures.min_path", candidates.min_path,
                    {.unit = "m",
                     .min = 0,
                     .max = 1e6,
                     .help = "Path length between two keyframes of the same session above which min_keyframes does not "
                             "apply."});
  configuration.add("closures.max_candidates", candidates.max_count,
                    {.min = 1, .max = 1000, .help = "Maximum number of candidates tried for one scan."});
  configuration.add("closures.min_travel", parts.closures.min_travel,
                    {.unit = "m",
                     .min = 0,
                     .max = 1e6,
                     .help = "Minimum travel between loop searches. 0: every keyframe is searched."});
  configuration.add("closures.min_period", parts.closures.min_period,
                    {.unit = "s",
                     .min = 0,
                     .max = 1e6,
                     .help = "Minimum time (of the data) between loop searches. 0: only min_travel applies."});
  configuration.add("closures.max_alignments", parts.back_end.max_alignments,
                    {.min = 0,
                     .max = 1000000,
                     .help = "Number of alignments of a keyframe after which repeated loop searches, along a merged or "
                             "corrected session, wait for the next keyframe. 0: no limit."});
  configuration.add("closures.before_merge", parts.back_end.close_before_merge,
                    {.help = "Close loops within a session before it has been merged with an earlier one."});
  configuration.add(
      "closures.submap_radius", parts.closures.submap.radius,
      {.min = 0, .max = 1000, .help = "Number of keyframes on each side of the candidate that form its submap."});
  configuration.add("closures.submap_length", parts.closures.submap.max_length,
                    {.unit = "m",
                     .min = 0,
                     .max = 1e6,
                     .help = "Maximum path length on each side of the candidate that its submap covers. 0: only "
                             "submap_radius applies."});
  configuration.add("closures.submap_fragment", parts.closures.submap.fragment,
                    {.min = 1,
                     .max = 1000,
                     .help = "Number of consecutive keyframes whose scans are combined once and share a submap. 1: "
                             "each keyframe has its own submap."});
  configuration.add("closures.voxel_size", parts.closures.submap.voxel_size,
                    {.unit = "m", .min = 0.02, .max = 10, .help = "Voxel size of submaps."});
  configuration.add("closures.scan_voxel", parts.closures.scan_voxel,
                    {.unit = "m",
                     .min = 0,
                     .max = 10,
                     .help = "Voxel size to which the aligned scan is downsampled. 0: as stored in the keyframe."});
  configuration.add(
      "closures.method", parts.registration.method,
      {{"point_to_plane", ClosureMethod::point_to_plane}, {"point_to_point", ClosureMethod::point_to_point}},
      {.help =
           "Registration of scans to submaps: coarse-to-fine point-to-plane ICP, or the paper's point-to-point ICP."});
  add_point_to_point(configuration, parts.registration.point_to_point);
  configuration.add("closures.accept_iteration_limit", gate.accept_iteration_limit,
                    {.help = "Accept alignments that reached the iteration limit without converging."});
  configuration.add("closures.noise_from_hessian", parts.noise.from_hessian,
                    {.help = "Compute a closure's covariance from the Hessian of the alignment instead of lambda times "
                             "its mean squared error."});
  configuration.add("closures.lambda", parts.noise.isotropic.lambda,
                    {.min = 1e-12,
                     .max = 1e6,
                     .help = "Ratio of the variance to the mean squared error if noise_from_hessian is false."});
  configuration.add(
      "closures.min_variance", parts.noise.isotropic.least,
      {.unit = "m^2, rad^2", .min = 1e-15, .max = 1, .help = "Minimum variance if noise_from_hessian is false."});
  configuration.add("closures.max_misfit", gate.max_misfit,
                    {.min = 0,
                     .max = 1e9,
                     .help = "Maximum ratio of the scan's distances from the submap's surfaces to those of the "
                             "submap's own points, in the worst of three directions, divided by the share of points "
                             "near a surface. 0: no limit."});
  configuration.add("closures.misfit_share", gate.misfit_share,
                    {.min = 0.01,
                     .max = 1,
                     .help = "Share of what constrains each direction, by the points nearest to surfaces, to which "
                             "max_misfit applies. The rest may be traffic."});
  configuration.add("closures.sure_misfit", gate.sure_misfit,
                    {.min = 0,
                     .max = 1e9,
                     .help = "The same over the square root of the share of residuals that determine the position in "
                             "its weakest direction, relative to 0.2. Beyond this, an alignment is repeated from both "
                             "sides in that direction and rejected unless it ends at the same pose. Requires "
                             "max_misfit > 0."});
  configuration.add("closures.repeat_below", gate.repeat_below,
                    {.min = 0,
                     .max = 1,
                     .help = "Share of residuals that determine the position in its weakest direction below which "
                             "alignments are repeated in any case."});
  configuration.add(
      "closures.repeat_shift", gate.repeat_shift,
      {.unit = "m", .min = 0, .max = 100, .help = "Distance of the repetitions' initial guesses from the pose."});
  configuration.add("closures.repeat_distance", gate.repeat_distance,
                    {.unit = "m", .min = 0, .max = 100, .help = "Maximum distance of their poses from that pose."});
  configuration.add("closures.usual_misfit", parts.closures.usual_misfit,
                    {.min = 0,
                     .max = 1e9,
                     .help = "Misfit beyond which the standard deviations of a closure grow in proportion to it. 0: "
                             "they do not depend on it."});
  configuration.add("closures.max_mean_squared_error", gate.max_mean_squared_error,
                    {.unit = "m^2",
                     .min = 0,
                     .max = 1e9,
                     .help = "Maximum mean squared distance of inliers to their nearest points. 0: no limit."});
  configuration.add("closures.min_inlier_ratio", gate.min_inlier_ratio,
                    {.min = 0, .max = 1, .help = "Minimum share of the scan's points that are inliers."});
  configuration.add("closures.max_translation", gate.max_translation,
                    {.unit = "m",
                     .min = 0,
                     .max = 1e9,
                     .help = "Reject alignments that correct the initial guess by more than this translation."});
  configuration.add("closures.max_rotation", gate.max_rotation,
                    {.unit = "deg",
                     .min = 0,
                     .max = 1e12,
                     .factor = radians_a_degree,
                     .help = "Reject alignments that correct the initial guess by more than this rotation."});
  configuration.add(
      "closures.outlier_threshold", parts.outliers.closures,
      {.min = 0,
       .max = 1e9,
       .help = "Squared Mahalanobis distance beyond which the graph rejects a closure as an outlier. 0: never."});
  configuration.add(
      "closures.search_again", parts.back_end.search_again,
      {.unit = "m",
       .min = 0,
       .max = 1e6,
       .help = "Repeat the loop search for keyframes that optimization moves by more than this. 0: never."});
  configuration.add("closures.at_once", parts.back_end.closures_at_once,
                    {.min = 1,
                     .max = 1000,
                     .help = "Optimize after this many direct closures, if none of them corrects its scan by more than "
                             "small_correction."});
  configuration.add("closures.small_correction", parts.back_end.small_correction,
                    {.unit = "m",
                     .min = 0,
                     .max = 1e3,
                     .help = "Optimize at once after a direct closure that corrects its scan by more than this."});
}

void add_chain(Configuration& configuration, BackEndParts& parts) {
  ChainOptions& chain = parts.chain;
  configuration.add("chain.enabled", chain.enabled, {.help = "Chain direct closures with earlier sessions."});
  configuration.add("chain.through_current_session", chain.through_current_session,
                    {.help = "Extend the breadth-first search through keyframes of the current session."});
  configuration.add(
      "chain.reach", chain.reach,
      {.min = 0,
       .max = 1000,
       .help = "Number of keyframes on each side of the partner whose closures count as the partner's own."});
  configuration.add(
      "chain.guess_through_chain", chain.guess_through_chain,
      {.help = "Take the initial guess of alignments from the direct closure instead of from the graph."});
  configuration.add(
      "chain.max_distance", chain.max_distance,
      {.unit = "m", .min = 0, .max = 1e6, .help = "Maximum distance of chained candidates. 0: no limit."});
  configuration.add("chain.min_separation", chain.min_separation,
                    {.min = 0,
                     .max = 100000,
                     .help = "Minimum number of keyframes between two chained candidates of the same session."});
  configuration.add(
      "chain.max_alignments", chain.max_alignments,
      {.min = 0, .max = 1000000, .help = "Maximum number of alignments per direct closure. 0: no limit."});
  configuration.add(
      "chain.hysteresis", chain.hysteresis,
      {.unit = "m",
       .min = 0,
       .max = 1e6,
       .help = "Prefer candidates next to those of the last direct closure, unless others are nearer by this."});
  configuration.add("chain.max_translation", chain.max_translation,
                    {.unit = "m",
                     .min = 0,
                     .max = 1e6,
                     .help = "Reject chained closures whose translation correction exceeds this. 0: no limit."});
  configuration.add("chain.max_rotation", chain.max_rotation,
                    {.unit = "deg",
                     .min = 0,
                     .max = 180,
                     .factor = radians_a_degree,
                     .help = "Reject chained closures whose rotation correction exceeds this."});
  configuration.add(
      "chain.correlation", chain.correlation,
      {.min = 0,
       .max = 1,
       .help = "Correlation of closures that share a scan. 0: each is independent. 1: all count as one."});
}

void add_merge_registration(Configuration& configuration, MergeRegistration& merging) {
  configuration.add(
      "merge.method", merging.method, {{"verified", MergeMethod::verified}, {"features", MergeMethod::features}},
      {.help =
           "Registration of submaps. verified: hypotheses from feature matches are refined and verified by the "
           "submaps. features: the paper's RANSAC; the keys from normal_radius to min_source_fitness belong to it."});
  Verifier& check = merging.verified.check;
  configuration.add("merge.max_plane_rmse", check.max_plane_rmse,
                    {.unit = "m",
                     .min = 0,
                     .max = 100,
                     .help = "Maximum root mean square of the distances of a submap's points from the other's planes "
                             "(method = verified)."});
  configuration.add(
      "merge.min_aligned_normals", check.min_aligned_normals,
      {.min = 0, .max = 1, .help = "Minimum share of normals that agree within 45 degrees (method = verified)."});
  configuration.add(
      "merge.min_overlap", check.min_overlap,
      {.min = 0, .max = 1, .help = "Minimum share of the smaller submap that overlaps the other (method = verified)."});
  FeatureRegistration<>& features = merging.features;
  configuration.add("merge.normal_radius", features.normals.radius,
                    {.unit = "m",
                     .min = 0.05,
                     .max = 100,
                     .help = "Search radius for the neighbours from which a normal is computed."});
  configuration.add("merge.normal_neighbors", features.normals.neighbors,
                    {.min = 5, .max = 1000, .help = "Maximum number of neighbours from which a normal is computed."});
  configuration.add(
      "merge.feature_radius", features.features.radius,
      {.unit = "m", .min = 0.1, .max = 100, .help = "Search radius for the neighbours that a feature describes."});
  configuration.add("merge.feature_neighbors", features.features.max_neighbors,
                    {.min = 2, .max = 10000, .help = "Maximum number of neighbours that a feature describes."});
  Ransac& ransac = features.estimator;
  configuration.add("merge.edge_length_ratio", ransac.edge_length_ratio,
                    {.min = 0, .max = 1, .help = "Minimum ratio of corresponding edges of two matched point triples."});
  configuration.add(
      "merge.max_distance", ransac.max_distance,
      {.unit = "m", .min = 0.01, .max = 100, .help = "Maximum distance of matched points that count as inliers."});
  configuration.add("merge.max_iterations", ransac.max_iterations,
                    {.min = 1, .max = 10000000, .help = "Maximum number of RANSAC iterations."});
  configuration.add("merge.confidence", ransac.confidence,
                    {.min = 0.01,
                     .max = 0.999999,
                     .help = "RANSAC terminates early once a correct sample was drawn with this probability."});
  configuration.add("merge.min_consensus", ransac.min_consensus,
                    {.min = 3, .max = 100000, .help = "Minimum number of matches that must agree."});
}

void add_merge(Configuration& configuration, BackEndParts& parts) {
  MergeOptions& merge = parts.merge;
  configuration.add("merge.enabled", merge.enabled, {.help = "Merge sessions into one frame."});
  configuration.add(
      "merge.gnss_radius", parts.gnss.radius,
      {.unit = "m", .min = 0, .max = 10000, .help = "Maximum distance between the GNSS fixes of merge candidates."});
  configuration.add("merge.gnss_with_height", parts.gnss.with_height,
                    {.help = "Measure that distance in three dimensions instead of horizontally."});
  configuration.add("merge.gnss_max_height", parts.gnss.max_height,
                    {.unit = "m", .min = 0, .max = 1e9, .help = "Maximum height difference of the two fixes."});
  configuration.add(
      "merge.gnss_max_sigma", parts.gnss.max_sigma,
      {.unit = "m", .min = 0, .max = 1e9, .help = "Ignore fixes with a larger stated standard deviation."});
  configuration.add("merge.max_candidates", parts.gnss.max_count,
                    {.min = 1, .max = 1000, .help = "Maximum number of candidates tried for one keyframe."});
  configuration.add(
      "merge.max_places", parts.places.max_count,
      {.min = 0,
       .max = 1000,
       .help = "Maximum number of places that a session without GNSS fixes is compared with, found by what "
               "their scans look like from above. 0: merging by GNSS only."});
  configuration.add("merge.place_length", parts.places.submap_length,
                    {.unit = "m", .min = 1, .max = 1000, .help = "Length of the path whose scans form one place."});
  configuration.add("merge.place_spacing", parts.places.spacing,
                    {.unit = "m", .min = 1, .max = 1000, .help = "Length of the path between two places of a map."});
  configuration.add("merge.place_cell_size", parts.places.image.cell_size,
                    {.unit = "m", .min = 0.05, .max = 10, .help = "Pixel size of the view from above."});
  configuration.add("merge.place_inliers", parts.places.index.min_inliers,
                    {.min = 3, .max = 1000, .help = "Minimum number of corners that two views have in common."});
  configuration.add("merge.min_travel", merge.min_travel,
                    {.unit = "m", .min = 0, .max = 1e6, .help = "Minimum travel between merge attempts."});
  configuration.add("merge.min_period", merge.min_period,
                    {.unit = "s", .min = 0, .max = 1e6, .help = "Minimum time (of the data) between merge attempts."});
  configuration.add(
      "merge.max_registrations", merge.max_registrations,
      {.min = 0,
       .max = 1000,
       .help = "Maximum number of candidates tried at one keyframe; the others are tried at the next ones. "
               "0: all at once."});
  configuration.add("merge.submap_radius", merge.submap_radius,
                    {.min = 0,
                     .max = 1000,
                     .help = "Number of keyframes on each side that form the earlier submap, and before the current "
                             "keyframe the current one."});
  configuration.add("merge.voxel_size", merge.voxel_size,
                    {.unit = "m", .min = 0.05, .max = 10, .help = "Voxel size of both submaps."});
  configuration.add("merge.submap_length", merge.submap_length,
                    {.unit = "m",
                     .min = 0,
                     .max = 1e6,
                     .help = "Maximum path length of a submap on each side. 0: no limit other than submap_radius."});
  add_merge_registration(configuration, parts.merging);
  configuration.add("merge.min_fitness", merge.min_fitness,
                    {.min = 0, .max = 1, .help = "Minimum ratio of inliers to target points (tau_R)."});
  configuration.add("merge.min_putative", merge.min_putative,
                    {.min = 0, .max = 1, .help = "Minimum ratio of inliers to matched features."});
  configuration.add("merge.min_source_fitness", merge.min_source_fitness,
                    {.min = 0, .max = 1, .help = "Minimum ratio of inliers to points of the current submap."});
  configuration.add(
      "merge.min_translation", merge.min_translation,
      {.unit = "m",
       .min = 0,
       .max = 1e6,
       .help = "Do not merge frames that differ by less than this translation and less than min_rotation."});
  configuration.add(
      "merge.min_rotation", merge.min_rotation,
      {.unit = "deg",
       .min = 0,
       .max = 180,
       .factor = radians_a_degree,
       .help = "Do not merge frames that differ by less than this rotation and less than min_translation."});
  configuration.add("merge.measurement", merge.measurement,
                    {{"refined", MergeMeasurement::refined},
                     {"submaps", MergeMeasurement::submaps},
                     {"scan", MergeMeasurement::scan}},
                    {.help = "Measurement of the closure that merges two sessions. refined: scan-to-submap alignment, "
                             "which must be accepted. submaps: the registration of the submaps. scan: scan-to-submap "
                             "alignment; if it is rejected, sessions are merged without a measurement."});
  configuration.add(
      "merge.lambda", merge.lambda,
      {.min = 1e-12, .max = 1e6, .help = "Ratio of the variance to the mean squared error (measurement = submaps)."});
  configuration.add("merge.confirmations", merge.confirmations,
                    {.min = 1, .max = 1000, .help = "Number of places that must agree before sessions are merged."});
  configuration.add("merge.min_place_distance", merge.min_place_distance,
                    {.unit = "m", .min = 0, .max = 1e6, .help = "Minimum travel between two such places."});
  configuration.add(
      "merge.supporting_scans", merge.supporting_scans,
      {.min = 0,
       .max = 20,
       .help = "Number of scans around one place that suffice to merge sessions if the GNSS fixes of both "
               "agree with it. 0: one place never suffices."});
  configuration.add("merge.max_fix_difference", merge.fixes.max_difference,
                    {.unit = "m",
                     .min = 0,
                     .max = 1e6,
                     .help = "Maximum median distance between the GNSS fixes of two sessions that agree with a merge. "
                             "Beyond twice this distance, they contradict it. 0: fixes are not compared."});
  configuration.add(
      "merge.misplaced", parts.gnss.misplaced,
      {.unit = "m",
       .min = 0,
       .max = 1e9,
       .help = "Minimum distance in the map, beyond merge.gnss_radius, of keyframes that are tried because "
               "their GNSS fixes are close to each other."});
  configuration.add("merge.chained", parts.back_end.chain_merges,
                    {.help = "Chain the closure that merges two sessions like a direct closure."});
  configuration.add("merge.recheck_travel", parts.back_end.recheck_travel,
                    {.unit = "m",
                     .min = 0,
                     .max = 1e6,
                     .help = "Minimum travel between loop searches along a session after its merge."});
  configuration.add(
      "merge.recheck_pause", parts.back_end.recheck_pause,
      {.min = 0, .max = 1000, .help = "Number of keyframes skipped after a successful one in these searches."});
  configuration.add("merge.recheck_chained", parts.back_end.chain_in_recheck,
                    {.help = "Chain the closures that these searches find."});
}

void add_gnss(Configuration& configuration, GnssFactorOptions& gnss) {
  configuration.add("graph.gnss", gnss.enabled, {.help = "Add GNSS fixes to the graph."});
  constexpr std::array<std::string_view, 3> axes{"graph.gnss_antenna_x", "graph.gnss_antenna_y",
                                                 "graph.gnss_antenna_z"};
  for (int axis = 0; axis < 3; ++axis)
    configuration.add(
        std::string(axes[static_cast<std::size_t>(axis)]), gnss.antenna[axis],
        {.unit = "m", .min = -100, .max = 100, .help = "Position of the GNSS antenna in the body frame."});
  configuration.add(
      "graph.gnss_bias", gnss.bias,
      {.unit = "m",
       .min = 0,
       .max = 1e4,
       .help = "Standard deviation of the constant bias of a session's fixes, beyond their stated error."});
  configuration.add(
      "graph.gnss_correlation_time", gnss.correlation_time,
      {.unit = "s",
       .min = 0,
       .max = 1e6,
       .help = "Time constant of the errors of fixes: fixes of twice this time count as one independent fix."});
  configuration.add(
      "graph.gnss_outlier_threshold", gnss.threshold,
      {.min = 0.1, .max = 1e9, .help = "Squared Mahalanobis distance beyond which a fix is rejected as an outlier."});
}

/// Which fixes are used, and when they suffice to place a frame on the Earth.
void add_fixes(Configuration& configuration, GnssFactorOptions& gnss) {
  configuration.add(
      "graph.gnss_max_sigma", gnss.max_sigma,
      {.unit = "m", .min = 0, .max = 1e9, .help = "Fixes that state a larger standard deviation are not used."});
  configuration.add("graph.gnss_min_fixes", gnss.min_fixes,
                    {.min = 3, .max = 1000000, .help = "Minimum number of fixes before a frame is georeferenced."});
  configuration.add("graph.gnss_min_spread", gnss.min_spread,
                    {.unit = "m",
                     .min = 0,
                     .max = 1e6,
                     .help = "Minimum root mean square spread of these fixes across their main direction."});
}

void add_gravity(Configuration& configuration, GravityFactorOptions& gravity) {
  configuration.add("graph.gravity", gravity.enabled,
                    {.help = "Add the direction of gravity, as measured by the accelerometer, to the graph."});
  configuration.add("graph.gravity_window", gravity.window,
                    {.unit = "s",
                     .min = 1,
                     .max = 1000,
                     .help = "Duration of the accelerometer measurements that yield one direction of gravity."});
  configuration.add(
      "graph.gravity_deviation", gravity.deviation,
      {.unit = "deg",
       .min = 0.001,
       .max = 90,
       .factor = radians_a_degree,
       .help = "Standard deviation of such a direction due to accelerometer bias and extrinsic calibration."});
  configuration.add("graph.gravity_speed_deviation", gravity.speed_deviation,
                    {.unit = "m/s",
                     .min = 0,
                     .max = 100,
                     .help = "Standard deviation of the velocity from odometry at each end of this duration."});
  configuration.add("graph.gravity_outlier_threshold", gravity.threshold,
                    {.min = 0.1,
                     .max = 1e9,
                     .help = "Squared Mahalanobis distance beyond which a direction is rejected as an outlier."});
  configuration.add("graph.gravity_start_deviation", gravity.start_deviation,
                    {.unit = "deg",
                     .min = 1e-4,
                     .max = 180,
                     .factor = radians_a_degree,
                     .help = "Standard deviation of roll and pitch in the prior on the first pose of a frame that "
                             "directions of gravity constrain."});
}

void add_submap_memory(Configuration& configuration, SubmapOptions& submap) {
  constexpr double mebibyte = 1 << 20;
  configuration.add("closures.submap_memory", submap.max_bytes,
                    {.unit = "MiB",
                     .min = 1,
                     .max = 1e6,
                     .factor = mebibyte,
                     .help = "Maximum memory of submaps that are kept for reuse. The least recently used are dropped "
                             "first."});
}

void add_graph(Configuration& configuration, MapGraphOptions& graph) {
  OdometryNoise& noise = graph.odometry_noise;
  configuration.add(
      "graph.odometry_translation", noise.translation,
      {.unit = "m",
       .min = 1e-6,
       .max = 100,
       .help = "Constant part of the translation standard deviation of an odometry step between keyframes."});
  configuration.add(
      "graph.odometry_translation_per_metre", noise.translation_per_metre,
      {.min = 0, .max = 1, .help = "Translation standard deviation of an odometry step per metre travelled."});
  configuration.add("graph.odometry_rotation", noise.rotation,
                    {.unit = "deg",
                     .min = 1e-6,
                     .max = 100,
                     .factor = radians_a_degree,
                     .help = "Constant part of the rotation standard deviation of an odometry step."});
  configuration.add("graph.odometry_rotation_per_metre", noise.rotation_per_metre,
                    {.unit = "deg/m",
                     .min = 0,
                     .max = 10,
                     .factor = radians_a_degree,
                     .help = "Rotation standard deviation of an odometry step per metre travelled."});
  configuration.add(
      "graph.odometry_rotation_per_radian", noise.rotation_per_radian,
      {.min = 0, .max = 1, .help = "Rotation standard deviation of an odometry step per radian turned, in radians."});
  configuration.add(
      "graph.odometry_stated_translation", noise.stated_translation,
      {.min = 0, .max = 100, .help = "Weight of the position standard deviations that odometry itself states."});
  configuration.add(
      "graph.odometry_stated_rotation", noise.stated_rotation,
      {.min = 0, .max = 100, .help = "Weight of the rotation standard deviations that odometry itself states."});
  OdometryNoise& unknown = graph.unknown_odometry;
  configuration.add("graph.odometry_unknown_translation", unknown.translation,
                    {.unit = "m",
                     .min = 1e-6,
                     .max = 100,
                     .help = "Constant part of the translation standard deviation of a step of recorded odometry "
                             "without stated covariance."});
  configuration.add("graph.odometry_unknown_translation_per_metre", unknown.translation_per_metre,
                    {.min = 0, .max = 1, .help = "Translation standard deviation of such a step per metre travelled."});
  configuration.add("graph.odometry_unknown_rotation", unknown.rotation,
                    {.unit = "deg",
                     .min = 1e-6,
                     .max = 100,
                     .factor = radians_a_degree,
                     .help = "Constant part of the rotation standard deviation of such a step."});
  configuration.add("graph.odometry_unknown_rotation_per_metre", unknown.rotation_per_metre,
                    {.unit = "deg/m",
                     .min = 0,
                     .max = 10,
                     .factor = radians_a_degree,
                     .help = "Rotation standard deviation of such a step per metre travelled."});
  configuration.add("graph.odometry_inflation", graph.odometry_inflation.enabled,
                    {.help = "Increase the covariance of odometry steps across scans that were lost or degenerate."});
  configuration.add("graph.anchor", graph.anchor,
                    {.min = 1e-9,
                     .max = 1,
                     .help = "Standard deviation (metres and radians) of the prior on the first pose of a frame."});
  configuration.add("graph.anchor_joined_sessions", graph.anchor_joined_sessions,
                    {.help = "Keep the prior on the first pose of a merged session, at the pose given by the merge."});
  configuration.add("graph.remeasure_loaded", graph.remeasure_loaded,
                    {.help = "Replace the measurements of a loaded map by the relative poses of its estimates."});
  configuration.add("graph.max_iterations", graph.optimizer.max_iterations,
                    {.min = 1, .max = 100000, .help = "Maximum number of iterations of one optimization."});
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
                     .help = "Squared Mahalanobis distance beyond which an odometry step is rejected when closures or "
                             "fixes contradict it. 0: never."});
  add_gnss(configuration, parts.back_end.graph.gnss);
  add_fixes(configuration, parts.back_end.graph.gnss);
  add_gravity(configuration, parts.back_end.graph.gravity);
  add_submap_memory(configuration, parts.closures.submap);
}

}  // namespace chainslam::mapper
