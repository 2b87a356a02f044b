#include "options.hpp"

#include <numbers>
#include <string>
#include <tuple>
#include <vector>

#include "datasets/extrinsic.hpp"

namespace chainslam::mapper {

namespace {

using support::Configuration;

constexpr double degree = std::numbers::pi / 180;

/// The extrinsic as numbers; none while it is not set.
Configuration::Target extrinsic_of(datasets::DatasetOptions& dataset) {
  return Configuration::Numbers{.form = std::string("[] or an array of ") + datasets::pose_layouts,
                                .get = [&dataset]() -> std::vector<double> {
                                  if (!dataset.T_body_lidar) return {};
                                  const Eigen::Vector3d& t = dataset.T_body_lidar->translation();
                                  const Eigen::Quaterniond q = dataset.T_body_lidar->rotation().quaternion();
                                  return {t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w()};
                                },
                                .problem =
                                    [](const std::vector<double>& numbers) {
                                      return numbers.empty() ? "" : datasets::pose_of_numbers(numbers).problem;
                                    },
                                .set =
                                    [&dataset](const std::vector<double>& numbers) {
                                      dataset.T_body_lidar =
                                          numbers.empty() ? std::nullopt : datasets::pose_of_numbers(numbers).pose;
                                    }};
}

void add_dataset(Configuration& configuration, datasets::DatasetOptions& dataset) {
  configuration.add("dataset.axes", dataset.axes,
                    {{"auto", datasets::NcltAxes::automatic},
                     {"nclt", datasets::NcltAxes::nclt},
                     {"kitti", datasets::NcltAxes::kitti}},
                    {.help = "Axes of the scans in an NCLT folder. nclt: x forward, y right, z down. kitti: x forward, "
                             "y left, z up. auto: nclt, unless the ground and a calib.txt say otherwise."});
  configuration.add("dataset.gnss", dataset.gnss,
                    {{"auto", datasets::NcltGnss::automatic},
                     {"rtk", datasets::NcltGnss::rtk},
                     {"consumer", datasets::NcltGnss::consumer},
                     {"none", datasets::NcltGnss::none}},
                    {.help = "Which positions of an NCLT folder to read. auto: RTK if it is there."});
  configuration.add("dataset.prefer_sync", dataset.prefer_sync,
                    {.help = "Read NCLT's velodyne_sync although there is a velodyne_hits.bin."});
  configuration.add("dataset.scan_rate", dataset.scan_rate,
                    {.unit = "Hz", .min = 0.01, .max = 1000, .help = "Scans per second where no file states times."});
  for (const auto& [key, topic, what] : {std::tuple{"dataset.lidar_topic", &dataset.lidar_topic, "scans"},
                                         std::tuple{"dataset.imu_topic", &dataset.imu_topic, "IMU samples"},
                                         std::tuple{"dataset.gnss_topic", &dataset.gnss_topic, "positions"}})
    configuration.add(
        key, *topic,
        {.help = std::string("Topic of a ROS recording's ") + what + "; if empty, the busiest of its kind."});
  configuration.add("dataset.times_from_azimuth", dataset.times_from_azimuth,
                    {.help = "Give the points of nuScenes and MARS, which have no times, those of a steady turn."});
  configuration.add(
      "dataset.kitti_raise", dataset.kitti_raise_deg,
      {.unit = "deg",
       .min = -5,
       .max = 5,
       .help = "Turn the points of KITTI's sequences up by this: their calibration has the lasers too low."});
  configuration.add("dataset.truth", dataset.truth,
                    {.help = "TUM file with the true poses T_map_body; --truth sets it too."});
  configuration.add(
      "dataset.T_body_lidar", extrinsic_of(dataset),
      {.help = "Pose of the LiDAR in the IMU's frame, p_body = T p_lidar, in place of the data set's own. "
               "Empty: calibration files of the data set, T_body_lidar.txt beside the data, or, without "
               "either, no offset."});
}

void add_imu(Configuration& configuration, ImuSettings& imu, datasets::DatasetOptions& dataset) {
  configuration.add("imu.use", imu.use,
                    {{"all", ImuUse::all}, {"gyroscope", ImuUse::gyroscope}, {"none", ImuUse::none}},
                    {.help = "What of the IMU's measurements odometry uses."});
  configuration.add("imu.calibrate", imu.calibrate,
                    {.help = "Find the offset of the IMU's clock and its axes by comparing it with the scans, and "
                             "correct them where they differ from imu.time_offset and T_body_lidar. Of source = "
                             "lidar_inertial, with imu.use = all."});
  configuration.add("imu.units", dataset.imu_units,
                    {{"auto", datasets::ImuUnitsGiven::automatic},
                     {"m/s^2, rad/s", datasets::ImuUnitsGiven::si},
                     {"g, rad/s", datasets::ImuUnitsGiven::g},
                     {"m/s^2, deg/s", datasets::ImuUnitsGiven::degrees},
                     {"g, deg/s", datasets::ImuUnitsGiven::g_and_degrees}},
                    {.help = "Units of accelerations and rates in the data. auto: by the data set's format, or by the "
                             "numbers."});
  configuration.add(
      "imu.time_offset", dataset.imu_time_offset,
      {.unit = "s",
       .min = -10,
       .max = 10,
       .help = "Added to the times of IMU samples: the time at which the LiDAR's clock has them less that "
               "of the IMU's own. Negative if samples are stamped late."});
  configuration.add("imu.gyro_noise", imu.noise.gyro,
                    {.unit = "rad/s/sqrt(Hz)", .min = 1e-7, .max = 1, .help = "Noise density of the gyroscope."});
  configuration.add("imu.accel_noise", imu.noise.accel,
                    {.unit = "m/s^2/sqrt(Hz)", .min = 1e-6, .max = 100, .help = "Noise density of the accelerometer."});
  configuration.add("imu.gyro_random_walk", imu.noise.gyro_bias_walk,
                    {.unit = "rad/s/sqrt(s)", .min = 0, .max = 1, .help = "Random walk of the gyroscope's bias."});
  configuration.add("imu.accel_random_walk", imu.noise.accel_bias_walk,
                    {.unit = "m/s^2/sqrt(s)", .min = 0, .max = 10, .help = "Random walk of the accelerometer's bias."});
  configuration.add("imu.gyro_range", imu.gyro_range,
                    {.unit = "deg/s",
                     .min = 0,
                     .max = 1e5,
                     .factor = degree,
                     .help = "Rates of an axis from here on are saturated, and count for little. 0: not known."});
  configuration.add("imu.accel_range", imu.accel_range,
                    {.unit = "m/s^2",
                     .min = 0,
                     .max = 1e5,
                     .help = "Accelerations of an axis from here on are saturated, and count for little. 0: not "
                             "known."});
}

void add_odometry(Configuration& configuration, OdometrySourceKind& source, LidarOdometryOptions<>& odometry) {
  configuration.add("odometry.source", source,
                    {{"lidar", OdometrySourceKind::lidar},
                     {"lidar_inertial", OdometrySourceKind::lidar_inertial},
                     {"fast_lio2", OdometrySourceKind::fast_lio2}},
                    {.help = "lidar_inertial: an iterated filter of scans and inertial readings, of scans alone where "
                             "there are none. fast_lio2: the same as it was published. lidar: scans, and the "
                             "gyroscope's rotation."});
  configuration.add("odometry.min_range", odometry.filter.min_range,
                    {.unit = "m", .min = 0, .max = 100, .help = "Nearer points are the carrier's own body."});
  configuration.add("odometry.max_range", odometry.filter.max_range,
                    {.unit = "m", .min = 1, .max = 1000, .help = "Farther points are left out."});
  configuration.add("odometry.every", odometry.filter.every,
                    {.min = 1, .max = 1000, .help = "Keep each n-th point of a scan."});
  configuration.add("odometry.voxel_size", odometry.scan_voxel,
                    {.unit = "m", .min = 0.02, .max = 10, .help = "Edge of the voxels that a scan is reduced to."});
  configuration.add(
      "odometry.map_radius", odometry.map_radius,
      {.unit = "m", .min = 5, .max = 2000, .help = "Half the edge of the local map's cube around the body."});
  configuration.add(
      "odometry.max_iterations", odometry.scan_to_map.max_iterations,
      {.min = 1, .max = 1000, .help = "Steps of the registration of a scan to the local map, by source = lidar."});
  configuration.add(
      "odometry.residual_scale", odometry.scan_to_map.residual_scale,
      {.unit = "m", .min = 0.001, .max = 10, .help = "Distances to planes beyond this count for little."});
  configuration.add_rule({"odometry.min_range", "odometry.max_range"}, "must be below odometry.max_range",
                         [&odometry] { return odometry.filter.min_range < odometry.filter.max_range; });
}

void add_keyframes(Configuration& configuration, KeyframeOptions& keyframes) {
  configuration.add("keyframes.distance", keyframes.distance,
                    {.unit = "m",
                     .min = 0,
                     .max = 1000,
                     .help = "A new keyframe after so far a way. 0: every scan. "
                             "Recorded keyframes are all taken."});
  configuration.add("keyframes.angle", keyframes.angle,
                    {.unit = "deg", .min = 0.1, .max = 180, .factor = degree, .help = "Or after so large a turn."});
  configuration.add(
      "keyframes.voxel_size", keyframes.scan_voxel,
      {.unit = "m", .min = 0, .max = 10, .help = "Edge of the voxels of the scan that is kept. 0 keeps all."});
}

void add_presets(Configuration& configuration, MapperOptions& options) {
  const auto apply_both = [&options] {
    apply(options.preset, options.back_end);
    apply(options.platform, options.preset, options.keyframes, options.back_end);
  };
  configuration.add(
      "preset", options.preset, {{"best", Preset::best}, {"paper", Preset::paper}, {"released", Preset::released}},
      {.help = "Sets closures, chain, merge and graph as a whole; other keys then change single values. paper: the "
               "method as published. released: its published code. best: what measures better.",
       .then = apply_both});
  configuration.add("platform", options.platform, {{"nclt", Platform::nclt}, {"mars", Platform::mars}},
                    {.help = "Keyframe distance, closure interval and rate for a slow robot (nclt) or a car (mars).",
                     .then = apply_both});
}

void add_closures(Configuration& configuration, BackEndParts& parts) {
  ProximityCandidates& candidates = parts.candidates;
  ClosureGate& gate = parts.closures.gate;
  configuration.add("closures.radius", candidates.radius,
                    {.unit = "m", .min = 0, .max = 1000, .help = "Keyframes so near are tried. 0: no closures."});
  configuration.add(
      "closures.min_interval", candidates.min_interval,
      {.unit = "s", .min = 0, .max = 1e6, .help = "Keyframes of the same session are tried after so long."});
  configuration.add("closures.max_candidates", candidates.max_count,
                    {.min = 1, .max = 1000, .help = "Keyframes tried for one scan at most."});
  configuration.add(
      "closures.min_travel", parts.closures.min_travel,
      {.unit = "m", .min = 0, .max = 1e6, .help = "Way between two searches. 0: every keyframe searches."});
  configuration.add(
      "closures.submap_radius", parts.closures.submap.radius,
      {.min = 0, .max = 1000, .help = "Keyframes on each side of the candidate that make up its submap."});
  configuration.add("closures.voxel_size", parts.closures.submap.voxel_size,
                    {.unit = "m", .min = 0.02, .max = 10, .help = "Edge of a submap's voxels."});
  configuration.add(
      "closures.method", parts.registration.method,
      {{"point_to_plane", ClosureMethod::point_to_plane}, {"point_to_point", ClosureMethod::point_to_point}},
      {.help = "How scans are aligned to submaps: coarse to fine on planes, or the paper's."});
  configuration.add("closures.max_distance", parts.registration.point_to_point.max_distance,
                    {.unit = "m", .min = 0.01, .max = 1000, .help = "Between matched points, of point_to_point."});
  configuration.add("closures.noise_from_hessian", parts.noise.from_hessian,
                    {.help = "Covariance from the alignment's Hessian; else lambda times its mean squared error."});
  configuration.add("closures.lambda", parts.noise.isotropic.lambda,
                    {.min = 1e-12, .max = 1e6, .help = "Variance over mean squared error, if not from the Hessian."});
  configuration.add("closures.max_mean_squared_error", gate.max_mean_squared_error,
                    {.unit = "m^2", .min = 0, .max = 1e9, .help = "Of the distances to nearest points, over inliers."});
  configuration.add("closures.max_residual", gate.max_residual,
                    {.unit = "m", .min = 0, .max = 1e9, .help = "Root mean square of what the method minimises."});
  configuration.add("closures.min_inlier_ratio", gate.min_inlier_ratio,
                    {.min = 0, .max = 1, .help = "Share of the scan's points with a partner in the submap."});
  configuration.add("closures.max_translation", gate.max_translation,
                    {.unit = "m", .min = 0, .max = 1e9, .help = "Corrections larger than this are not believed."});
  configuration.add("closures.max_rotation", gate.max_rotation,
                    {.unit = "deg",
                     .min = 0,
                     .max = 1e12,
                     .factor = degree,
                     .help = "Corrections larger than this are not believed."});
  configuration.add(
      "closures.kernel_width", parts.kernel.width,
      {.min = 0.1, .max = 1e9, .help = "Standard deviations at which the graph halves a closure's weight."});
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
  configuration.add("chain.max_rotation", chain.max_rotation,
                    {.unit = "deg", .min = 0, .max = 180, .factor = degree, .help = "More contradicts the chain."});
  configuration.add(
      "chain.correlation", chain.correlation,
      {.min = 0, .max = 1, .help = "Of closures that share a scan: 0 counts each in full, 1 all as one."});
}

void add_merge(Configuration& configuration, BackEndParts& parts) {
  MergeOptions& merge = parts.merge;
  configuration.add("merge.enabled", merge.enabled, {.help = "Whether sessions are joined into one frame."});
  configuration.add("merge.gnss_radius", parts.gnss.radius,
                    {.unit = "m", .min = 0, .max = 10000, .help = "Keyframes whose fixes are so near are tried."});
  configuration.add("merge.max_candidates", parts.gnss.max_count,
                    {.min = 1, .max = 1000, .help = "Keyframes tried for one keyframe at most."});
  configuration.add("merge.min_travel", merge.min_travel,
                    {.unit = "m", .min = 0, .max = 1e6, .help = "Way between two attempts."});
  configuration.add("merge.voxel_size", merge.voxel_size,
                    {.unit = "m", .min = 0.05, .max = 10, .help = "Edge of the voxels of both submaps."});
  configuration.add("merge.min_fitness", merge.min_fitness,
                    {.min = 0, .max = 1, .help = "Inliers over target points (tau_R)."});
  configuration.add("merge.min_putative", merge.min_putative,
                    {.min = 0, .max = 1, .help = "Inliers over matched features."});
  configuration.add("merge.refine", merge.refine,
                    {.help = "Whether an alignment of the scan to the submap has to accept the place too."});
  configuration.add("merge.confirmations", merge.confirmations,
                    {.min = 1, .max = 1000, .help = "Places that must agree before sessions are joined."});
  configuration.add("merge.apart", merge.apart,
                    {.unit = "m", .min = 0, .max = 1e6, .help = "Way between two such places."});
  configuration.add("merge.recheck_travel", parts.back_end.recheck_travel,
                    {.unit = "m", .min = 0, .max = 1e6, .help = "Way between searches along a joined session."});
  configuration.add("merge.recheck_chained", parts.back_end.chain_in_recheck,
                    {.help = "Whether what these searches find is chained."});
}

void add_graph(Configuration& configuration, MapGraphOptions& graph) {
  OdometryNoise& noise = graph.odometry_noise;
  configuration.add("graph.odometry_translation", noise.translation,
                    {.unit = "m", .min = 1e-6, .max = 100, .help = "Standard deviation of a step between keyframes,"});
  configuration.add("graph.odometry_translation_per_metre", noise.translation_per_metre,
                    {.min = 0, .max = 1, .help = "and what each metre of the way adds."});
  configuration.add("graph.odometry_rotation", noise.rotation,
                    {.unit = "deg", .min = 1e-6, .max = 100, .factor = degree, .help = "The same for the rotation,"});
  configuration.add("graph.odometry_rotation_per_metre", noise.rotation_per_metre,
                    {.unit = "deg/m", .min = 0, .max = 10, .factor = degree, .help = "and what each metre adds."});
  configuration.add("graph.anchor_joined_sessions", graph.anchor_joined_sessions,
                    {.help = "Whether a joined session's start is held where the merge put it."});
  configuration.add("graph.remeasure_loaded", graph.remeasure_loaded,
                    {.help = "Whether a loaded map's measurements are replaced by what its poses say."});
  configuration.add("graph.max_iterations", graph.optimizer.max_iterations,
                    {.min = 1, .max = 100000, .help = "Steps of one optimisation."});
}

void add_goals(Configuration& configuration, Goals& goals) {
  configuration.add(
      "goals.max_ape", goals.max_ape,
      {.unit = "m", .min = 0, .max = 1e6, .help = "Largest error against the truth. 0 asks for nothing."});
  configuration.add(
      "goals.min_odometry_ape", goals.min_odometry_ape,
      {.unit = "m", .min = 0, .max = 1e6, .help = "Least error of odometry alone: a drive that is a test."});
  configuration.add("goals.min_ape_ratio", goals.min_ape_ratio,
                    {.min = 0, .max = 1e6, .help = "Odometry's error over the optimised one."});
  configuration.add("goals.min_closures", goals.min_closures, {.min = 0, .max = 1e6, .help = "Accepted closures."});
  configuration.add("goals.min_chained_closures", goals.min_chained_closures,
                    {.min = 0, .max = 1e6, .help = "Accepted closures that chaining found."});
  configuration.add(
      "goals.max_inter_session_error", goals.max_inter_session_error,
      {.unit = "m",
       .min = 0,
       .max = 1e6,
       .help = "Largest error between keyframes of different sessions at one place. 0 asks for nothing."});
  configuration.add("goals.max_lost_share", goals.max_lost_share,
                    {.min = 0,
                     .max = 1,
                     .help = "Largest share of a session's scans that odometry may lose or leave out. 1 allows any."});
  configuration.add(
      "goals.max_map_restarts", goals.max_map_restarts,
      {.min = -1, .max = 1e6, .help = "Restarts of the local map in a session, after many lost scans. -1 allows any."});
  configuration.add("goals.merged", goals.merged, {.help = "All sessions must end in one frame."});
}

}  // namespace

const char* name_of(OdometrySourceKind source) {
  switch (source) {
    case OdometrySourceKind::lidar:
      return "lidar";
    case OdometrySourceKind::lidar_inertial:
      return "lidar_inertial";
    case OdometrySourceKind::fast_lio2:
      return "fast_lio2";
  }
  return "";
}

support::Configuration make_configuration(MapperOptions& options) {
  support::Configuration configuration;
  add_presets(configuration, options);
  add_dataset(configuration, options.dataset);
  add_odometry(configuration, options.odometry_source, options.odometry);
  add_imu(configuration, options.imu, options.dataset);
  add_keyframes(configuration, options.keyframes);
  add_closures(configuration, options.back_end);
  add_chain(configuration, options.back_end);
  add_merge(configuration, options.back_end);
  add_graph(configuration, options.back_end.back_end.graph);
  configuration.add("output.map_voxel", options.map_voxel,
                    {.unit = "m", .min = 0.01, .max = 10, .help = "Edge of the voxels of map.ply."});
  add_goals(configuration, options.goals);
  return configuration;
}

std::string configuration_text(MapperOptions options) { return make_configuration(options).print(); }

void configure(MapperOptions& options, const std::filesystem::path& file, const std::vector<std::string>& overrides) {
  support::Configuration configuration = make_configuration(options);
  if (!file.empty()) configuration.load(file);
  for (const std::string& assignment : overrides) configuration.set(assignment);
  configuration.apply();
}

}  // namespace chainslam::mapper
