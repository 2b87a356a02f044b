#include "inspect_imu.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <variant>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/odometry/imu_alignment.hpp"
#include "chainslam/odometry/lidar_odometry.hpp"
#include "chainslam/sensor/imu_check.hpp"
#include "session_odometry.hpp"
#include "support/progress.hpp"

namespace chainslam::mapper {

namespace {

/// LiDAR odometry without the IMU, and the comparison of both.
class Comparison {
 public:
  Comparison(const MapperOptions& options, const datasets::DatasetInfo& dataset)
      : odometry_(lidar_options(options)),
        check_(imu_check_of(options.dataset)),
        alignment_(alignment_options(dataset)),
        calibration_(given_calibration(options.dataset, dataset)) {}

  void add(const Packet& packet) {
    if (const auto* sample = std::get_if<ImuSample>(&packet))
      check_.add(*sample, [&](const ImuSample& checked) { alignment_.add(checked); });
    if (!std::holds_alternative<LidarScan>(packet)) return;
    const std::optional<Frame> frame = odometry_.process(packet, threads_);
    if (!frame) return;
    if (!first_) first_ = frame->time;
    seconds_ = to_seconds(frame->time - *first_);
    constexpr double angle = 5e-4, distance = 0.02;  // rad, m: what registration leaves
    if (frame->health.status == FrameStatus::good)
      alignment_.add(LidarPose{frame->time, frame->T_odom_body, angle, distance});
  }

  [[nodiscard]] double seconds() const { return seconds_; }
  [[nodiscard]] support::ImuCalibration calibration() const {
    support::ImuCalibration calibration = calibration_;
    calibration.found = alignment_.estimate();
    return calibration;
  }

 private:
  /// Its body is the LiDAR.
  [[nodiscard]] static LidarOdometryOptions<> lidar_options(const MapperOptions& options) {
    LidarOdometryOptions<> lidar = options.odometry;
    lidar.T_body_lidar = SE3d();
    return lidar;
  }

  ThreadPool threads_;
  LidarOdometry<> odometry_;
  ImuCheck check_;
  ImuAlignment alignment_;
  support::ImuCalibration calibration_;
  std::optional<Timestamp> first_;
  double seconds_ = 0;
};

}  // namespace

void inspect_imu(const std::filesystem::path& path, const MapperOptions& options, double seconds,
                 const std::stop_token& stop, datasets::Inspection& result) {
  const std::unique_ptr<datasets::Dataset> dataset = datasets::open_dataset(path, options.dataset);
  const datasets::DatasetInfo& info = dataset->info();
  const auto has = [&](SensorKind kind) {
    return std::ranges::count(info.sensors, kind, &datasets::SensorInfo::kind) > 0;
  };
  if (info.has_odometry || !has(SensorKind::imu) || !has(SensorKind::lidar)) return;
  Comparison comparison(options, info);
  support::Progress progress;
  support::ProgressState state{.stage = "comparing IMU and scans", .total = static_cast<Index>(std::ceil(seconds))};
  while (!stop.stop_requested() && comparison.seconds() < seconds) {
    const std::optional<Packet> packet = dataset->next();
    if (!packet) break;
    comparison.add(*packet);
    state.done = static_cast<Index>(comparison.seconds());
    progress.update(state);
  }
  progress.finish();
  const support::ImuCalibration calibration = comparison.calibration();
  char used[64];
  std::snprintf(used, sizeof used, "the first %.0f s%s", comparison.seconds(),
                stop.stop_requested() ? ", interrupted" : "");
  result.facts.emplace_back("IMU and scans", used);
  result.facts.emplace_back("imu.time_offset", time_offset_text(calibration));
  result.facts.emplace_back("R_body_lidar", rotation_text(calibration));
  for (std::string& finding : support::contradictions(calibration)) result.warnings.push_back(std::move(finding));
}

}  // namespace chainslam::mapper
