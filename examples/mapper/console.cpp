#include "console.hpp"

#include <cstdio>

#include "chainslam/core/error.hpp"
#include "support/imu_calibration.hpp"
#include "support/summary.hpp"

namespace chainslam::mapper {

namespace {

/// What may help odometry that loses scans.
const char* remedy(OdometrySourceKind source) {
  switch (source) {
    case OdometrySourceKind::lidar:
      return "run `chainslam inspect` on the data: gaps, times of points, ranges; with an IMU try --set "
             "odometry.source=lidar_inertial";
    case OdometrySourceKind::lidar_inertial:
      return "run `chainslam inspect` on the data: units, clock and extrinsic calibration of the IMU, gaps; try --set "
             "odometry.source=lidar, which uses only scans";
    case OdometrySourceKind::fast_lio2:
      return "try --set odometry.source=lidar_inertial or lidar: FAST-LIO2 needs a start at rest and a known extrinsic "
             "calibration";
  }
  return "";
}

}  // namespace

void print_notes(const char* mark, const std::vector<std::string>& notes) {
  for (const std::string& note : notes) std::fprintf(stderr, "%s %s\n", mark, printable(note).c_str());
}

void print_memory_error(std::uint64_t max_memory, const std::string& remedy) {
  std::fprintf(stderr, "error: memory\n  found: more than %.0f MB in use (--max-memory)\n  do: %s\n",
               1e-6 * static_cast<double>(max_memory), printable(remedy, true).c_str());
}

void print_verdict(const support::Verdict& verdict, OdometrySourceKind source) {
  std::printf("verdict      %s\n", printable(verdict.headline).c_str());
  if (verdict.failed && !verdict.sentences.empty()) std::printf("  do: %s\n", remedy(source));
}

void print_imu(const support::RunSummary& summary) {
  for (const support::SessionSummary& session : summary.sessions) {
    const std::string use = support::text_of(session.health.imu_use);
    if (session.loaded || use.empty()) continue;
    std::printf("IMU          %s%s\n", summary.sessions.size() > 1 ? (printable(session.name) + ": ").c_str() : "",
                use.c_str());
    if (!session.calibration) continue;
    std::printf("             imu.time_offset by the scans: %s\n", time_offset_text(*session.calibration).c_str());
    std::printf("             times of scans by the IMU: %s\n", scan_times_text(*session.calibration).c_str());
    std::printf("             rotation of T_body_lidar by the scans: %s\n",
                rotation_text(*session.calibration).c_str());
  }
}

void print_errors(const RunOutcome& outcome) {
  if (outcome.optimized_errors)
    std::printf("error        %.3f m rmse, odometry alone %.3f m (against the truth, rigidly aligned)\n",
                outcome.optimized_errors->translation.rmse, outcome.odometry_errors->translation.rmse);
  if (outcome.inter_session_errors)
    std::printf("             %.3f m between keyframes of different sessions at one place\n",
                outcome.inter_session_errors->translation.rmse);
}

}  // namespace chainslam::mapper
