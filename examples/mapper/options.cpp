#include "options.hpp"

#include <algorithm>
#include <numbers>
#include <optional>
#include <string>
#include <string_view>
#include <tuple>
#include <utility>
#include <vector>

#include "back_end_options.hpp"
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

/// Something known beforehand, or "auto": to be inferred from the data.
template <class Value>
Configuration::Target hint_of(std::optional<Value>& hint, const std::vector<std::pair<std::string, Value>>& choices) {
  Configuration::Choice choice{.names = {"auto"}, .get = {}, .set = {}};
  for (const auto& [name, value] : choices) choice.names.push_back(name);
  choice.get = [&hint, choices] {
    const auto same = [&](const auto& named) { return hint == named.second; };
    return hint ? static_cast<std::size_t>(std::ranges::find_if(choices, same) - choices.begin()) + 1 : 0;
  };
  choice.set = [&hint, choices](std::size_t i) { hint = i == 0 ? std::nullopt : std::optional(choices[i - 1].second); };
  return choice;
}

/// How to read a time field of points whose meaning the data leave open.
void add_point_time(Configuration& configuration, datasets::PointTimeHints& hints) {
  configuration.add("dataset.point_time_unit",
                    hint_of<datasets::TimeUnit>(hints.unit, {{"s", datasets::TimeUnit::seconds},
                                                             {"ms", datasets::TimeUnit::milliseconds},
                                                             {"us", datasets::TimeUnit::microseconds},
                                                             {"ns", datasets::TimeUnit::nanoseconds}}),
                    {.help = "Unit of the time field of points in PCD, PLY and ROS messages. auto: inferred."});
  configuration.add("dataset.point_time_base",
                    hint_of<datasets::PointTimeBase>(hints.base, {{"relative", datasets::PointTimeBase::relative},
                                                                  {"absolute", datasets::PointTimeBase::absolute}}),
                    {.help = "Whether these times count from the scan's stamp or are absolute. auto: inferred."});
  configuration.add("dataset.point_time_direction",
                    hint_of<bool>(hints.counts_back, {{"forward", false}, {"backward", true}}),
                    {.help = "Whether positive relative times are after (forward) or before (backward) the scan's "
                             "stamp. auto: forward; times that decrease from point to point are ambiguous."});
}

void add_dataset(Configuration& configuration, datasets::DatasetOptions& dataset) {
  configuration.add("dataset.axes", dataset.axes,
                    {{"auto", datasets::NcltAxes::automatic},
                     {"nclt", datasets::NcltAxes::nclt},
                     {"kitti", datasets::NcltAxes::kitti}},
                    {.help = "Axes of the scans in an NCLT folder. nclt: x forward, y right, z down. kitti: x forward, "
                             "y left, z up. auto: nclt, unless the ground plane and a calib.txt contradict it."});
  configuration.add("dataset.gnss", dataset.gnss,
                    {{"auto", datasets::NcltGnss::automatic},
                     {"rtk", datasets::NcltGnss::rtk},
                     {"consumer", datasets::NcltGnss::consumer},
                     {"none", datasets::NcltGnss::none}},
                    {.help = "Selects which positions of an NCLT folder are read. auto: RTK if available."});
  configuration.add("dataset.prefer_sync", dataset.prefer_sync,
                    {.help = "Read NCLT's velodyne_sync even if velodyne_hits.bin exists."});
  configuration.add(
      "dataset.scan_rate", dataset.scan_rate,
      {.unit = "Hz", .min = 0.01, .max = 1000, .help = "Scan rate that is assumed where no file states times."});
  for (const auto& [key, topic, what] : {std::tuple{"dataset.lidar_topic", &dataset.lidar_topic, "scans"},
                                         std::tuple{"dataset.imu_topic", &dataset.imu_topic, "IMU measurements"},
                                         std::tuple{"dataset.gnss_topic", &dataset.gnss_topic, "positions"}})
    configuration.add(
        key, *topic,
        {.help = std::string("Topic of a ROS recording's ") + what + ". Empty: the topic with the most messages."});
  add_point_time(configuration, dataset.point_time);
  configuration.add("dataset.times_from_azimuth", dataset.times_from_azimuth,
                    {.help = "Compute the times of points of nuScenes and MARS, which have none, from their azimuth at "
                             "constant rotation rate."});
  configuration.add(
      "dataset.kitti_elevation_offset", dataset.kitti_elevation_offset_deg,
      {.unit = "deg",
       .min = -5,
       .max = 5,
       .help = "Elevation correction of the points of KITTI's sequences, whose calibration has the lasers too low."});
  configuration.add("dataset.truth", dataset.truth,
                    {.help = "TUM file with the ground-truth poses T_map_body; also set by --truth."});
  configuration.add("dataset.T_body_lidar", extrinsic_of(dataset),
                    {.help = "Extrinsic calibration: pose of the LiDAR in the IMU frame, p_body = T p_lidar; overrides "
                             "the data set's own. Empty: use the calibration files of the data set or T_body_lidar.txt "
                             "next to the data; without either, the identity."});
}

void add_imu(Configuration& configuration, ImuSettings& imu, datasets::DatasetOptions& dataset) {
  configuration.add("imu.use", imu.use,
                    {{"all", ImuUse::all}, {"gyroscope", ImuUse::gyroscope}, {"none", ImuUse::none}},
                    {.help = "Selects which IMU measurements odometry uses."});
  configuration.add(
      "imu.calibrate", imu.calibrate,
      {.help =
           "Estimate the time offset and the axes of the IMU by comparing it with the scans, and correct them where "
           "they differ from imu.time_offset and T_body_lidar. Requires source = lidar_inertial and imu.use = all."});
  configuration.add("imu.units", dataset.imu_units,
                    {{"auto", datasets::ImuUnitsGiven::automatic},
                     {"m/s^2, rad/s", datasets::ImuUnitsGiven::si},
                     {"g, rad/s", datasets::ImuUnitsGiven::g},
                     {"m/s^2, deg/s", datasets::ImuUnitsGiven::degrees},
                     {"g, deg/s", datasets::ImuUnitsGiven::g_and_degrees}},
                    {.help = "Units of accelerations and rates in the data. auto: by the data set's format, or "
                             "inferred from the values."});
  configuration.add("imu.time_offset", dataset.imu_time_offset,
                    {.unit = "s",
                     .min = -10,
                     .max = 10,
                     .help = "Offset that is added to the times of IMU measurements: LiDAR clock minus IMU clock. "
                             "Negative if measurements are stamped late."});
  configuration.add("imu.gyro_noise", imu.noise.gyro,
                    {.unit = "rad/s/sqrt(Hz)", .min = 1e-7, .max = 1, .help = "Noise density of the gyroscope."});
  configuration.add(
      "imu.accel_noise", imu.noise.accel,
      {.unit = "m/s^2/sqrt(Hz)",
       .min = 1e-6,
       .max = 100,
       .help =
           "Noise density of the accelerometer. lidar_inertial estimates it from the scans; this is the lower bound."});
  configuration.add("imu.gyro_random_walk", imu.noise.gyro_bias_walk,
                    {.unit = "rad/s/sqrt(s)", .min = 0, .max = 1, .help = "Random walk of the gyroscope bias."});
  configuration.add("imu.accel_random_walk", imu.noise.accel_bias_walk,
                    {.unit = "m/s^2/sqrt(s)", .min = 0, .max = 10, .help = "Random walk of the accelerometer bias."});
  configuration.add(
      "imu.gyro_range", imu.gyro_range,
      {.unit = "deg/s",
       .min = 0,
       .max = 1e5,
       .factor = degree,
       .help = "Rates of an axis at or above this value are saturated and get a low weight. 0: unknown."});
  configuration.add(
      "imu.accel_range", imu.accel_range,
      {.unit = "m/s^2",
       .min = 0,
       .max = 1e5,
       .help = "Accelerations of an axis at or above this value are saturated and get a low weight. 0: unknown."});
}

/// What a front end sets beside itself: FAST-LIO2's published numbers, or what the others have by default.
std::vector<std::pair<std::string_view, std::string_view>> numbers_of(OdometrySourceKind source) {
  if (source == OdometrySourceKind::fast_lio2)
    return {{"odometry.voxel_size", "0.5"}, {"odometry.map_radius", "500"}, {"odometry.max_iterations", "5"}};
  return {{"odometry.voxel_size", "0.75"}, {"odometry.map_radius", "150"}, {"odometry.max_iterations", "20"}};
}

void add_odometry(Configuration& configuration, OdometrySourceKind& source, LidarOdometryOptions<>& odometry,
                  support::FrameClock& clock, bool& scan_clock) {
  configuration.add(
      "odometry.source", source,
      {{"lidar", OdometrySourceKind::lidar},
       {"lidar_inertial", OdometrySourceKind::lidar_inertial},
       {"fast_lio2", OdometrySourceKind::fast_lio2}},
      {.help = "Selects the odometry. lidar_inertial: iterated Kalman filter on scans and IMU measurements, LiDAR-only "
               "where there are none. fast_lio2: FAST-LIO2 as published; also sets voxel_size, map_radius and "
               "max_iterations. lidar: scans and the gyroscope's rotation.",
       .brings = [&source] { return numbers_of(source); }});
  configuration.add("odometry.min_range", odometry.filter.min_range,
                    {.unit = "m", .min = 0, .max = 100, .help = "Discard returns closer than this (vehicle body)."});
  configuration.add("odometry.max_range", odometry.filter.max_range,
                    {.unit = "m", .min = 1, .max = 1000, .help = "Discard returns farther than this."});
  configuration.add("odometry.every", odometry.filter.every,
                    {.min = 1, .max = 1000, .help = "Use every n-th point of a scan."});
  configuration.add("odometry.voxel_size", odometry.scan_voxel,
                    {.unit = "m", .min = 0.02, .max = 10, .help = "Voxel size to which a scan is downsampled."});
  configuration.add(
      "odometry.map_radius", odometry.map_radius,
      {.unit = "m", .min = 5, .max = 2000, .help = "Half the edge length of the local map's cube around the body."});
  configuration.add("odometry.max_iterations", odometry.scan_to_map.max_iterations,
                    {.min = 1,
                     .max = 1000,
                     .help = "Maximum number of iterations of scan-to-map registration (source = lidar) or of the "
                             "filter update (fast_lio2)."});
  configuration.add(
      "odometry.residual_scale", odometry.scan_to_map.residual_scale,
      {.unit = "m", .min = 0.001, .max = 10, .help = "Residuals (distances to planes) beyond this get a low weight."});
  configuration.add(
      "odometry.clock", clock, {{"lidar", support::FrameClock::lidar}, {"imu", support::FrameClock::imu}},
      {.help = "Clock of the times of poses. lidar: as the scans are stamped. imu: shifted to the IMU's by the offset "
               "that imu.calibrate finds, where scans are stamped late or early, but IMU and GNSS agree."});
  configuration.add(
      "odometry.scan_clock", scan_clock,
      {.help = "Estimate by how much the time of each scan is off, by the IMU, and correct pose and points "
               "of the scan (source = lidar_inertial). false: the stated times are exact."});
  configuration.add_rule({"odometry.min_range", "odometry.max_range"}, "must be below odometry.max_range",
                         [&odometry] { return odometry.filter.min_range < odometry.filter.max_range; });
}

void add_keyframes(Configuration& configuration, KeyframeOptions& keyframes) {
  configuration.add(
      "keyframes.distance", keyframes.distance,
      {.unit = "m",
       .min = 0,
       .max = 1000,
       .help = "Minimum translation between keyframes. 0: every scan is a keyframe. All recorded keyframes are used."});
  configuration.add("keyframes.angle", keyframes.angle,
                    {.unit = "deg",
                     .min = 0.1,
                     .max = 180,
                     .factor = degree,
                     .help = "Minimum rotation between keyframes; either distance or angle suffices."});
  configuration.add("keyframes.voxel_size", keyframes.scan_voxel,
                    {.unit = "m",
                     .min = 0,
                     .max = 10,
                     .help = "Voxel size to which the stored scan is downsampled. 0: all points are stored."});
}

void add_scan_memory(Configuration& configuration, std::size_t& bytes) {
  constexpr double mebibyte = 1 << 20;
  configuration.add("keyframes.scan_memory", bytes,
                    {.unit = "MiB",
                     .min = 0,
                     .max = 1e6,
                     .factor = mebibyte,
                     .help = "Maximum memory of the keyframes' scans, which are read from the map's file when they are "
                             "needed. The least recently used are dropped first; what the map becomes does not depend "
                             "on it."});
}

void add_localizer(Configuration& configuration, LocalizerOptions& localizer, PlaceCandidateOptions& places) {
  configuration.add("localize.distance", localizer.scans.distance,
                    {.unit = "m",
                     .min = 0,
                     .max = 1000,
                     .help = "Minimum translation between scans that are registered to the map."});
  configuration.add("localize.period", localizer.min_period,
                    {.unit = "s", .min = 0, .max = 1000, .help = "Minimum time between them."});
  configuration.add("localize.min_evidence", localizer.start.min_evidence,
                    {.min = 1,
                     .max = 1000,
                     .help = "Number of recognitions of a place plus scans registered there, less twice the scans that "
                             "were not, needed for a start."});
  configuration.add("localize.min_recognitions", localizer.start.min_recognitions,
                    {.min = 1, .max = 1000, .help = "Number of recognitions among them."});
  configuration.add("localize.min_scans", localizer.start.min_scans,
                    {.min = 1, .max = 1000, .help = "Number of scans that must be registered there, each by itself."});
  configuration.add("localize.min_travel", localizer.start.min_travel,
                    {.unit = "m", .min = 0, .max = 1000, .help = "Minimum travel from the first to the last of them."});
  configuration.add("localize.shift", localizer.start.shift,
                    {.unit = "m",
                     .min = 0,
                     .max = 100,
                     .help = "Distance along the path, to either side, from which a scan must be registered to the "
                             "same place again to count for a start. 0: it need not be."});
  configuration.add(
      "localize.max_distance", localizer.max_distance,
      {.unit = "m", .min = 1, .max = 1e6, .help = "Travel without a registration beyond which the pose is uncertain."});
  configuration.add(
      "localize.lost_distance", localizer.lost_distance,
      {.unit = "m", .min = 1, .max = 1e6, .help = "Travel without a registration beyond which the pose is lost."});
  configuration.add_rule({"localize.max_distance", "localize.lost_distance"},
                         "must not be above localize.lost_distance",
                         [&localizer] { return localizer.max_distance <= localizer.lost_distance; });
  configuration.add("localize.place_length", places.submap_length,
                    {.unit = "m", .min = 1, .max = 1000, .help = "Length of the path whose scans form one place."});
  configuration.add("localize.place_spacing", places.spacing,
                    {.unit = "m", .min = 1, .max = 1000, .help = "Length of the path between two places of the map."});
  configuration.add("localize.place_cell_size", places.image.cell_size,
                    {.unit = "m", .min = 0.05, .max = 10, .help = "Pixel size of the view from above."});
  configuration.add("localize.place_inliers", places.index.min_inliers,
                    {.min = 3, .max = 1000, .help = "Minimum number of corners that two views have in common."});
  configuration.add("localize.max_places", places.max_count,
                    {.min = 1, .max = 1000, .help = "Maximum number of places that one scan is registered to."});
}

void add_presets(Configuration& configuration, MapperOptions& options) {
  const auto brings = [&options] { return values_of(options.preset, options.platform); };
  configuration.add(
      "preset", options.preset, {{"best", Preset::best}, {"paper", Preset::paper}, {"released", Preset::released}},
      {.help =
           "Configures the whole system (odometry, keyframes, closures, chain, merge and graph); other keys then "
           "change single values. paper: the method as published. released: its published code. best: tuned defaults.",
       .brings = brings});
  configuration.add(
      "platform", options.platform, {{"nclt", Platform::nclt}, {"mars", Platform::mars}},
      {.help =
           "Vehicle: a slow robot (nclt) or a car (mars). Sets keyframe distance, closure interval and odometry.clock; "
           "with the presets paper and released also closure rate, minimum range and IMU noise.",
       .brings = brings});
}

void add_goals(Configuration& configuration, Goals& goals) {
  configuration.add(
      "goals.max_ape", goals.max_ape,
      {.unit = "m", .min = 0, .max = 1e6, .help = "Maximum APE (rms) against the ground truth. 0: no goal."});
  configuration.add(
      "goals.min_odometry_ape", goals.min_odometry_ape,
      {.unit = "m", .min = 0, .max = 1e6, .help = "Minimum APE of odometry alone, for drives that serve as a test."});
  configuration.add(
      "goals.min_ape_ratio", goals.min_ape_ratio,
      {.min = 0, .max = 1e6, .help = "Minimum ratio of the APE of odometry to the APE of the optimized map."});
  configuration.add("goals.min_closures", goals.min_closures,
                    {.min = 0, .max = 1e6, .help = "Minimum number of accepted closures."});
  configuration.add("goals.min_chained_closures", goals.min_chained_closures,
                    {.min = 0, .max = 1e6, .help = "Minimum number of accepted chained closures."});
  configuration.add("goals.max_inter_session_error", goals.max_inter_session_error,
                    {.unit = "m",
                     .min = 0,
                     .max = 1e6,
                     .help = "Maximum error between keyframes of different sessions at the same place. 0: no goal."});
  configuration.add(
      "goals.max_lost_share", goals.max_lost_share,
      {.min = 0, .max = 1, .help = "Maximum share of a session's scans that odometry may lose or skip. 1: no limit."});
  configuration.add(
      "goals.max_map_restarts", goals.max_map_restarts,
      {.min = -1,
       .max = 1e6,
       .help = "Maximum number of resets of the local map in a session, after many lost scans. -1: no limit."});
  configuration.add("goals.merged", goals.merged, {.help = "Require all sessions to end in one frame."});
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
  add_odometry(configuration, options.odometry_source, options.odometry, options.frame_clock, options.scan_clock);
  add_imu(configuration, options.imu, options.dataset);
  add_keyframes(configuration, options.keyframes);
  add_scan_memory(configuration, options.scan_memory);
  add_back_end(configuration, options.back_end);
  add_localizer(configuration, options.localizer, options.localizer_places);
  configuration.add("output.map_voxel", options.map_voxel,
                    {.unit = "m", .min = 0.01, .max = 10, .help = "Voxel size of map.ply."});
  add_goals(configuration, options.goals);
  return configuration;
}

std::string configuration_text(const MapperOptions& options) {
  MapperOptions printed;  // whose defaults are the program's own
  const support::Configuration configuration = make_configuration(printed);
  printed = options;
  return configuration.print();
}

void configure(MapperOptions& options, const std::filesystem::path& file, const std::vector<std::string>& overrides) {
  support::Configuration configuration = make_configuration(options);
  if (!file.empty()) configuration.load(file);
  for (const std::string& assignment : overrides) configuration.set(assignment);
  configuration.apply();
}

}  // namespace chainslam::mapper
