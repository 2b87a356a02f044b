#include "options.hpp"

#include <numbers>

namespace chainslam::mapper {

namespace {

using support::Configuration;

constexpr double degree = std::numbers::pi / 180;

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
  configuration.add("dataset.truth", dataset.truth,
                    {.help = "TUM file with the true poses T_map_body; --truth sets it too."});
}

void add_odometry(Configuration& configuration, LidarOdometryOptions<>& odometry) {
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
  configuration.add("odometry.max_iterations", odometry.scan_to_map.max_iterations,
                    {.min = 1, .max = 1000, .help = "Steps of the registration of a scan to the local map."});
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

void add_closures(Configuration& configuration, MapperOptions& options) {
  ProximityCandidates& candidates = options.candidates;
  ClosureGate& gate = options.closures.gate;
  configuration.add("closures.radius", candidates.radius,
                    {.unit = "m", .min = 0, .max = 1000, .help = "Keyframes so near are tried. 0: no closures."});
  configuration.add(
      "closures.min_interval", candidates.min_interval,
      {.unit = "s", .min = 0, .max = 1e6, .help = "Keyframes of the same session are tried after so long."});
  configuration.add("closures.max_candidates", candidates.max_count,
                    {.min = 1, .max = 1000, .help = "Keyframes tried for one scan at most."});
  configuration.add(
      "closures.min_travel", options.closures.min_travel,
      {.unit = "m", .min = 0, .max = 1e6, .help = "Way between two searches. 0: every keyframe searches."});
  configuration.add(
      "closures.submap_radius", options.closures.submap.radius,
      {.min = 0, .max = 1000, .help = "Keyframes on each side of the candidate that make up its submap."});
  configuration.add("closures.voxel_size", options.closures.submap.voxel_size,
                    {.unit = "m", .min = 0.02, .max = 10, .help = "Edge of a submap's voxels."});
  configuration.add("closures.max_mean_squared_error", gate.max_mean_squared_error,
                    {.unit = "m^2", .min = 0, .max = 100, .help = "Of the distances to nearest points, over inliers."});
  configuration.add("closures.max_residual", gate.max_residual,
                    {.unit = "m", .min = 0, .max = 100, .help = "Root mean square of the distances to planes."});
  configuration.add("closures.min_inlier_ratio", gate.min_inlier_ratio,
                    {.min = 0, .max = 1, .help = "Share of the scan's points with a partner in the submap."});
  configuration.add("closures.max_translation", gate.max_translation,
                    {.unit = "m", .min = 0, .max = 1e4, .help = "Corrections larger than this are not believed."});
  configuration.add("closures.max_rotation", gate.max_rotation,
                    {.unit = "deg",
                     .min = 0,
                     .max = 180,
                     .factor = degree,
                     .help = "Corrections larger than this are not believed."});
  configuration.add(
      "closures.kernel_width", options.closure_kernel.width,
      {.min = 0.1, .max = 1e9, .help = "Standard deviations at which the graph halves a closure's weight."});
}

void add_graph(Configuration& configuration, BackEndOptions& back_end) {
  OdometryNoise& noise = back_end.odometry_noise;
  configuration.add("graph.odometry_translation", noise.translation,
                    {.unit = "m", .min = 1e-6, .max = 100, .help = "Standard deviation of a step between keyframes,"});
  configuration.add("graph.odometry_translation_per_metre", noise.translation_per_metre,
                    {.min = 0, .max = 1, .help = "and what each metre of the way adds."});
  configuration.add("graph.odometry_rotation", noise.rotation,
                    {.unit = "deg", .min = 1e-6, .max = 100, .factor = degree, .help = "The same for the rotation,"});
  configuration.add("graph.odometry_rotation_per_metre", noise.rotation_per_metre,
                    {.unit = "deg/m", .min = 0, .max = 10, .factor = degree, .help = "and what each metre adds."});
  configuration.add("graph.max_iterations", back_end.optimizer.max_iterations,
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
}

}  // namespace

support::Configuration make_configuration(MapperOptions& options) {
  support::Configuration configuration;
  add_dataset(configuration, options.dataset);
  add_odometry(configuration, options.odometry);
  add_keyframes(configuration, options.keyframes);
  add_closures(configuration, options);
  add_graph(configuration, options.back_end);
  configuration.add("output.map_voxel", options.map_voxel,
                    {.unit = "m", .min = 0.01, .max = 10, .help = "Edge of the voxels of map.ply."});
  add_goals(configuration, options.goals);
  return configuration;
}

void configure(MapperOptions& options, const std::filesystem::path& file, const std::vector<std::string>& overrides) {
  support::Configuration configuration = make_configuration(options);
  if (!file.empty()) configuration.load(file);
  for (const std::string& assignment : overrides) configuration.set(assignment);
  configuration.apply();
}

}  // namespace chainslam::mapper
