#include "presets.hpp"

namespace chainslam::mapper {

namespace {

using PresetText = std::string_view;

constexpr PresetValue alike(PresetText key, PresetText value, PresetText source) {
  return {key, {value, value}, {value, value}, source};
}
constexpr PresetValue differ(PresetText key, PresetText paper, PresetText released, PresetText source) {
  return {key, {paper, paper}, {released, released}, source};
}
constexpr PresetValue by_platform(PresetText key, PresetText nclt, PresetText mars, PresetText source) {
  return {key, {nclt, mars}, {nclt, mars}, source};
}

constexpr PresetText no_bound = "1e9";  ///< of a bound that asks for nothing

// "paper III-B" is a section of the paper (Li et al., Chain-SLAM); "code" its released program, in which the NCLT and
// MARS configurations and launch files count as code. Where the paper is silent, `paper` has what the code has; where
// the two contradict each other, each preset follows its own. "ours" is what neither states.
constexpr PresetValue preset_values[] = {
    // Front end: FAST-LIO2, by its published rules (`fast_lio2_options`) with these numbers.
    alike("odometry.source", "fast_lio2", "paper III-A; code: FAST-LIO2's front end"),
    by_platform("odometry.min_range", "4", "1", "paper III-E (1): the sensor's own; code: blind"),
    alike("odometry.max_range", "1000", "code: no bound (det_range moves the map alone)"),
    alike("odometry.every", "4", "code: point_filter_num"),
    alike("odometry.voxel_size", "0.5", "code: filter_size_surf; the map's the same"),
    alike("odometry.map_radius", "500", "code: cube_side_length 1000 m"),
    alike("odometry.max_iterations", "4", "code: max_iteration 3, whose loop makes one pass more"),
    alike("odometry.clock", "lidar", "code: the scan's time"),
    // Its covariances are a reading's, and these their roots.
    by_platform("imu.gyro_noise", "0.1", "0.039547439866570375", "paper III-E (1); code: gyr_cov 0.01, 1.564e-3"),
    by_platform("imu.accel_noise", "0.1", "0.06319810123729984", "paper III-E (1); code: acc_cov 0.01, 3.994e-3"),
    by_platform("imu.gyro_random_walk", "0.01", "0.00596992462263972", "the same; code: b_gyr_cov 1e-4, 3.564e-5"),
    by_platform("imu.accel_random_walk", "0.01", "0.008022468448052631", "the same; code: b_acc_cov 1e-4, 6.436e-5"),

    by_platform("keyframes.distance", "3", "10", "paper III-E (2): by platform; code: 3 m, 10 m"),
    alike("keyframes.angle", "11.459155902616464", "code: 0.2 rad"),
    alike("keyframes.voxel_size", "0", "code: keyframeStorageDownsampleEn false"),

    // Direct closures.
    alike("closures.radius", "15", "paper III-B: a radius; code: 15 m"),
    alike("closures.start_distance", "0", "paper III-B: aligned from the pose in the graph"),
    {"closures.min_interval",
     {"30", "30"},
     {"30", "60"},
     "paper III-B, III-E: one minimum interval for both; code: 30 s, 60 s"},
    alike("closures.min_keyframes", "0", "paper III-B: the interval alone"),
    alike("closures.max_candidates", "1", "paper III-B: the candidate pair; code: the nearest"),
    alike("closures.heading_weight", "0", "paper III-B: spatial proximity"),
    {"closures.min_travel", {"16", "25"}, {"0", "0"}, "paper III-E: v / f_lc > r_lc = 15 m; MARS 10 m/s at 0.4 Hz"},
    {"closures.min_period",
     {"0", "0"},
     {"3.3333333333333335", "2.5"},
     "code: loopClosureFrequency 0.3 Hz, 0.4 Hz, whatever the pace"},
    alike("closures.max_places", "0", "paper III-B: spatial proximity"),
    alike("closures.max_alignments", "0", "paper III-D: the graph is rebuilt at once"),
    differ("closures.before_merge", "true", "false", "code: with a map loaded, none before the merge"),
    alike("closures.submap_radius", "20", "paper III-E: n; code: 20"),
    alike("closures.submap_length", "0", "paper III-E, code: keyframes, however far apart"),
    alike("closures.submap_fragment", "1", "paper III-B: the submap around each candidate"),
    alike("closures.voxel_size", "0.4", "paper III-E: voxel-downsampled; code: 0.4 m"),
    alike("closures.scan_voxel", "0.4", "the same of the scan"),
    alike("closures.method", "point_to_point", "paper III-B: |p - T q|^2"),
    differ("closures.max_distance", "2", "150", "paper III-B: inliers, ours: 2 m; code: 150 m"),
    alike("closures.max_iterations", "100", "code: setMaximumIterations"),
    alike("closures.coarse_stride", "1", "paper III-B: all points, no coarse stage"),
    alike("closures.min_overlap", "0", "paper III-B: the error alone decides"),
    alike("closures.degeneracy_threshold", "0", "paper III-B: no direction is held"),
    alike("closures.translation_tolerance", "0.001", "code: transformation epsilon 1e-6, in PCL the square"),
    alike("closures.rotation_tolerance", "0.08102846845413955", "the same, in PCL of 1 - cos: sqrt(2e-6) rad"),
    alike("closures.cost_tolerance", "1e-6", "code: Euclidean fitness epsilon, in PCL relative"),
    differ("closures.accept_iteration_limit", "false", "true",
           "paper III-B: if ICP converges; code: PCL counts its limit"),
    alike("closures.noise_from_hessian", "false", "paper III-B: lambda e I"),
    alike("closures.lambda", "1e-4", "paper III-B: a scaling factor; code: noise_scale"),
    alike("closures.min_variance", "1e-12", "paper III-B: none; ours: no matrix is singular"),
    alike("closures.max_mean_squared_error", "0.3", "paper III-B: tau; code: 0.3"),
    alike("closures.max_misfit", "0", "paper III-B: no such test"),
    alike("closures.min_inlier_ratio", "0", "paper III-B: no such test"),
    alike("closures.max_translation", no_bound, "paper III-B: no such test"),
    alike("closures.max_rotation", no_bound, "paper III-B: no such test"),
    alike("closures.outlier_threshold", "0", "paper III-A: squared errors, all of them"),
    alike("closures.search_again", "0", "paper III-B: each keyframe once"),
    alike("closures.at_once", "1", "paper III-A, code: whenever factors are added"),

    // Chained closures.
    {"chain.enabled", {"true", "true"}, {"true", "false"}, "paper III-C; code: add_chained_closures, false for MARS"},
    differ("chain.through_current_session", "true", "false", "paper Alg. 1: all reachable; code: loaded nodes only"),
    alike("chain.reach", "0", "paper III-C: N(j) of j alone"),
    alike("chain.guess_through_chain", "false", "code: from the graph's estimate"),
    alike("chain.max_distance", "0", "paper III-E: no depth limit"),
    alike("chain.min_separation", "0", "paper Alg. 1: every k"),
    differ("chain.max_alignments", "0", "200", "paper III-E: no bound; code: none, ours: a run ends"),
    alike("chain.hysteresis", "0", "paper Alg. 1: no such rule"),
    alike("chain.max_translation", "0", "paper Alg. 1: the error alone decides"),
    alike("chain.correlation", "0", "paper Alg. 1: each counts in full"),

    // Merging.
    alike("merge.gnss_radius", "10", "paper III-D: proximity; code: 10 m"),
    differ("merge.gnss_with_height", "false", "true", "paper III-D: proximity; code: a k-d tree of three coordinates"),
    alike("merge.gnss_max_height", no_bound, "paper III-D: no such test"),
    alike("merge.max_places", "0", "paper III-D: places by GNSS"),
    alike("merge.gnss_max_sigma", no_bound, "paper III-D: no such test; code: covariance ignored"),
    alike("merge.max_candidates", "1", "paper III-D: the candidate pair; code: the nearest"),
    alike("merge.min_travel", "0", "paper III-D: no such rule; code: each new keyframe"),
    {"merge.min_period", {"0", "0"}, {"3.3333333333333335", "2.5"}, "code: in the loop thread, at its frequency"},
    alike("merge.submap_radius", "20", "paper III-E: n; code: 20"),
    alike("merge.submap_length", "0", "paper III-E, code: keyframes, however far apart"),
    alike("merge.method", "features", "paper III-D: FPFH and RANSAC"),
    alike("merge.voxel_size", "1", "paper III-E: voxel-downsampled; code: 1 m"),
    differ("merge.normal_radius", "2", "4", "code: 2 m, taken twice; paper: not stated"),
    alike("merge.normal_neighbors", "30", "code: hybrid search"),
    alike("merge.feature_radius", "5", "paper III-D: FPFH; code: 5 m"),
    alike("merge.feature_neighbors", "100", "code: hybrid search"),
    alike("merge.edge_length_ratio", "0.9", "code: RANSAC's edge-length check"),
    alike("merge.max_distance", "1", "code: RANSAC's distance check and inliers"),
    alike("merge.max_iterations", "10000", "code: RANSAC"),
    alike("merge.confidence", "0.999", "code: RANSAC"),
    alike("merge.min_consensus", "3", "paper III-D, code: fitness alone decides"),
    differ("merge.min_fitness", "0.3", "0", "paper III-D: tau_R over target points, not stated, ours by measurement"),
    differ("merge.min_source_fitness", "0", "0.5", "code: fitness 0.5, in Open3D 0.15.1 inliers over source points"),
    alike("merge.min_putative", "0", "paper III-D: no such test"),
    differ("merge.min_translation", "0", "1", "code: not joined if nearer than 1 m and"),
    differ("merge.min_rotation", "0", "2.0258172320113044", "0.05 in the Frobenius norm; paper: no such test"),
    differ("merge.measurement", "submaps", "scan", "paper III-D: alignment factors; code: ICP of the pair, if it fits"),
    alike("merge.lambda", "1e-4", "paper III-B: lambda e I, of III-D's factor, too"),
    alike("merge.confirmations", "1", "paper III-D: the first accepted"),
    alike("merge.supporting_scans", "0", "paper III-D: no such rule"),
    alike("merge.max_fix_difference", "0", "paper III-D: GNSS proposes alone"),
    alike("merge.misplaced", no_bound, "paper III-D: sessions are joined once"),
    alike("merge.chained", "true", "paper III-D: as in III-C; code: ICP of the pair and its chain"),
    {"merge.recheck_travel", {"16", "25"}, {"0", "0"}, "paper III-D: as in III-B; code: every keyframe"},
    differ("merge.recheck_pause", "0", "4", "code: after a success the next four are skipped"),
    differ("merge.recheck_chained", "true", "false", "paper III-D: as in III-C; code: direct closures only"),

    // Graph.
    alike("graph.odometry_translation", "0.01", "code: 1e-4 m^2"),
    alike("graph.odometry_translation_per_metre", "0", "code: the same for each step"),
    alike("graph.odometry_rotation", "0.05729577951308232", "code: 1e-6 rad^2"),
    alike("graph.odometry_rotation_per_metre", "0", "code: the same for each step"),
    alike("graph.odometry_rotation_per_radian", "0", "code: the same for each step"),
    alike("graph.odometry_stated_translation", "0", "code: the same for each step"),
    alike("graph.odometry_stated_rotation", "0", "code: the same for each step"),
    alike("graph.odometry_unknown_translation", "0.01", "code: the same for each step"),
    alike("graph.odometry_unknown_translation_per_metre", "0", "code: the same for each step"),
    alike("graph.odometry_unknown_rotation", "0.05729577951308232", "code: the same for each step"),
    alike("graph.odometry_unknown_rotation_per_metre", "0", "code: the same for each step"),
    alike("graph.odometry_outlier_threshold", "0", "paper III-A: squared errors, all of them"),
    alike("graph.gnss", "false", "paper III-A: priors, odometry, closures"),
    alike("graph.gravity", "false", "paper III-A: priors, odometry, closures"),
    alike("graph.odometry_inflation", "false", "code: the same for each step"),
    alike("graph.anchor", "1e-6", "paper III-A: prior factors; code: variance 1e-12"),
    alike("graph.anchor_joined_sessions", "true", "paper III-D: the prior is replaced by one at the aligned pose"),
    differ("graph.remeasure_loaded", "false", "true", "paper III-D: restored; code: recomputed from optimized poses"),
};

/// What a slow robot and a car differ in, in `best`.
constexpr struct {
  PresetText key;
  std::array<PresetText, 2> values;
} best_by_platform[] = {
    {"keyframes.distance", {"3", "10"}},
    {"closures.min_interval", {"30", "60"}},
    {"closures.min_travel", {"4", "15"}},
    // A car's LiDAR may run on a clock of its own, while IMU and GNSS receiver share one: 20 ms are 0.2 m at 10 m/s.
    {"odometry.clock", {"lidar", "imu"}}};

}  // namespace

std::span<const PresetValue> preset_table() { return preset_values; }

std::vector<std::pair<std::string_view, std::string_view>> values_of(Preset preset, Platform platform) {
  const auto column = static_cast<std::size_t>(platform);
  std::vector<std::pair<std::string_view, std::string_view>> values;
  if (preset == Preset::best)
    for (const auto& row : best_by_platform) values.emplace_back(row.key, row.values[column]);
  else
    for (const PresetValue& row : preset_values)
      values.emplace_back(row.key, (preset == Preset::paper ? row.paper : row.released)[column]);
  return values;
}

}  // namespace chainslam::mapper
