#include "inspect_imu.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/sensor/frame.hpp"
#include "session_odometry.hpp"
#include "support/progress.hpp"

namespace chainslam::mapper {

namespace {

/// The odometry that finds clock and axes of the IMU, whichever one the settings choose for mapping.
std::unique_ptr<SessionOdometry> calibrating_odometry(MapperOptions options, const datasets::DatasetInfo& dataset) {
  options.odometry_source = OdometrySourceKind::lidar_inertial;
  options.imu.calibrate = true;
  options.imu.use = ImuUse::all;
  return make_session_odometry(options, dataset);
}

}  // namespace

void inspect_imu(const std::filesystem::path& path, const MapperOptions& options, double seconds,
                 const std::stop_token& stop, datasets::Inspection& result) {
  const std::unique_ptr<datasets::Dataset> dataset = datasets::open_dataset(path, options.dataset);
  const datasets::DatasetInfo& info = dataset->info();
  const auto has = [&](SensorKind kind) {
    return std::ranges::count(info.sensors, kind, &datasets::SensorInfo::kind) > 0;
  };
  if (info.has_odometry || !has(SensorKind::imu) || !has(SensorKind::lidar)) return;
  const std::unique_ptr<SessionOdometry> odometry = calibrating_odometry(options, info);
  const ThreadPool threads;
  std::optional<Timestamp> first;
  double passed = 0;
  support::Progress progress;
  support::ProgressState state{.stage = "comparing IMU and scans", .total = static_cast<Index>(std::ceil(seconds))};
  while (!stop.stop_requested() && passed < seconds) {
    const std::optional<Packet> packet = dataset->next();
    if (!packet) break;
    const std::optional<Frame> frame = odometry->process(*packet, threads);
    if (!frame) continue;
    if (!first) first = frame->time;
    passed = to_seconds(frame->time - *first);
    state.done = static_cast<Index>(passed);
    progress.update(state);
  }
  progress.finish();
  const auto calibration = odometry->calibration().value_or(given_calibration(options.dataset, info));
  char used[64];
  std::snprintf(used, sizeof used, "the first %.0f s%s", passed, stop.stop_requested() ? ", interrupted" : "");
  result.facts.emplace_back("IMU and scans", used);
  result.facts.emplace_back("imu.time_offset", time_offset_text(calibration));
  result.facts.emplace_back("R_body_lidar", rotation_text(calibration));
  for (std::string& finding : support::contradictions(calibration)) result.warnings.push_back(std::move(finding));
}

}  // namespace chainslam::mapper
