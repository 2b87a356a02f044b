#include "session_odometry.hpp"

#include <limits>
#include <utility>

#include "chainslam/odometry/lidar_inertial_odometry.hpp"
#include "chainslam/odometry/lidar_inertial_options.hpp"
#include "chainslam/odometry/lidar_odometry.hpp"
#include "chainslam/odometry/self_calibrating.hpp"
#include "chainslam/search/ikd_tree.hpp"

namespace chainslam::mapper {

namespace {

using FastLio2 = LidarInertialOdometry<IkdTree<float, NearestToCenter>, Trivial>;

template <class Odometry>
class PlainOdometry final : public SessionOdometry {
 public:
  explicit PlainOdometry(typename Odometry::Options options) : odometry_(std::move(options)) {}

  std::optional<Frame> process(const Packet& packet, const ThreadPool& threads) override {
    return odometry_.process(packet, threads);
  }
  std::optional<Frame> flush(const ThreadPool& threads) override {
    if constexpr (requires { odometry_.flush(threads); })
      return odometry_.flush(threads);
    else
      return std::nullopt;
  }
  [[nodiscard]] LidarOdometryCounts counts() const override { return odometry_.counts(); }

 private:
  Odometry odometry_;
};

/// Finds out how the IMU is mounted and when it measures, and remembers since when that is used.
class CalibratingOdometry final : public SessionOdometry {
 public:
  CalibratingOdometry(LidarInertialOdometryOptions<> options, const ImuAlignmentOptions& alignment,
                      support::ImuCalibration given)
      : odometry_(std::move(options), alignment), calibration_(std::move(given)) {}

  std::optional<Frame> process(const Packet& packet, const ThreadPool& threads) override {
    imu_ |= std::holds_alternative<ImuSample>(packet);
    return followed(odometry_.process(packet, threads));
  }
  std::optional<Frame> flush(const ThreadPool& threads) override { return followed(odometry_.flush(threads)); }
  [[nodiscard]] LidarOdometryCounts counts() const override { return odometry_.counts(); }
  [[nodiscard]] std::optional<support::ImuCalibration> calibration() const override {
    if (!imu_) return std::nullopt;
    support::ImuCalibration calibration = calibration_;
    calibration.found = odometry_.alignment();
    calibration.scan_time_deviation = odometry_.odometry().scan_time_deviation();
    return calibration;
  }

 private:
  std::optional<Frame> followed(std::optional<Frame> frame) {
    if (!frame) return frame;
    if (!first_) first_ = frame->time;
    calibration_.follow(odometry_.odometry().imu_correction(), to_seconds(frame->time - *first_));
    return frame;
  }

  SelfCalibrating<LidarInertialOdometry<>> odometry_;
  support::ImuCalibration calibration_;
  std::optional<Timestamp> first_;
  bool imu_ = false;
};

/// Noise that was not changed stays that of the odometry: a published filter has its own.
template <class Options>
void set_imu(const ImuSettings& imu, Options& options) {
  ImuNoise& noise = options.motion.process.noise;
  for (const auto part : {&ImuNoise::gyro, &ImuNoise::accel, &ImuNoise::gyro_bias_walk, &ImuNoise::accel_bias_walk})
    if (imu.noise.*part != ImuNoise{}.*part) noise.*part = imu.noise.*part;
  if (imu.gyro_range > 0) options.motion.imu.gyro_range = imu.gyro_range;
  if (imu.accel_range > 0) options.motion.imu.accel_range = imu.accel_range;
  options.imu_use = imu.use;
}

template <class Options>
Options inertial(Options options, const MapperOptions& given, const SE3d& T_body_lidar) {
  options.T_body_lidar = T_body_lidar;
  options.filter = given.odometry.filter;
  options.local_map.radius = given.odometry.map_radius;
  options.imu_check = imu_check_of(given.dataset);
  set_imu(given.imu, options);
  return options;
}

}  // namespace

std::unique_ptr<SessionOdometry> make_session_odometry(const MapperOptions& given,
                                                       const datasets::DatasetInfo& dataset) {
  switch (given.odometry_source) {
    case OdometrySourceKind::lidar: {
      LidarOdometryOptions<> options = given.odometry;
      options.T_body_lidar = dataset.T_body_lidar;
      options.imu_check = imu_check_of(given.dataset);
      return std::make_unique<PlainOdometry<LidarOdometry<>>>(options);
    }
    case OdometrySourceKind::fast_lio2: {
      auto options = inertial(fast_lio2_options(), given, dataset.T_body_lidar);
      options.scan_voxel = given.odometry.scan_voxel;
      options.iteration.max_iterations = options.scan_to_map.max_matchings = given.odometry.scan_to_map.max_iterations;
      return std::make_unique<PlainOdometry<FastLio2>>(options);
    }
    case OdometrySourceKind::lidar_inertial:
      break;
  }
  LidarInertialOdometryOptions<> options = inertial(LidarInertialOdometryOptions<>{}, given, dataset.T_body_lidar);
  options.scan_voxel = given.odometry.scan_voxel;
  if (!given.scan_clock) options.scan_clock.largest = 0;
  options.scan_to_map.residual_scale = given.odometry.scan_to_map.residual_scale;
  if (!given.imu.calibrate || given.imu.use != ImuUse::all)
    return std::make_unique<PlainOdometry<LidarInertialOdometry<>>>(options);
  return std::make_unique<CalibratingOdometry>(options, alignment_options(dataset),
                                               given_calibration(given.dataset, dataset));
}

ImuCheckOptions imu_check_of(const datasets::DatasetOptions& dataset) {
  ImuCheckOptions check;
  if (dataset.imu_units != datasets::ImuUnitsGiven::automatic) check.units.emplace();
  return check;
}

ImuAlignmentOptions alignment_options(const datasets::DatasetInfo& dataset) {
  ImuAlignmentOptions options;
  options.T_body_lidar = dataset.T_body_lidar;
  if (!dataset.extrinsic_known) options.rotation_deviation = std::numeric_limits<double>::infinity();
  return options;
}

support::ImuCalibration given_calibration(const datasets::DatasetOptions& options,
                                          const datasets::DatasetInfo& dataset) {
  return {.T_body_lidar = dataset.T_body_lidar,
          .extrinsic_given = dataset.extrinsic_known,
          .time_offset = to_seconds(options.imu_time_offset),
          .found = {},
          .applied = {},
          .scan_time_deviation = 0,
          .clock_corrected = {},
          .axes_corrected = {}};
}

}  // namespace chainslam::mapper
