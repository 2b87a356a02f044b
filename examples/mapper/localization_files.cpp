#include "localization_files.hpp"

#include <array>
#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <string>

namespace chainslam::mapper {

namespace {

std::string head_of_localizations() {
  constexpr std::array axes{"x", "y", "z", "rx", "ry", "rz"};
  std::string text = "time_ns,status,registered,frame,reference,x,y,z,qx,qy,qz,qw";
  for (std::size_t i = 0; i < axes.size(); ++i)
    for (std::size_t j = i; j < axes.size(); ++j) text += std::string(",cov_") + axes[i] + "_" + axes[j];
  return text + "\n";
}

std::string row_of(const Localization& frame) {
  constexpr int fields_of_pose = 2 + 7 + 21;
  char text[320];
  std::snprintf(text, sizeof text, "%lld,%s,%d", static_cast<long long>(frame.time.nanoseconds()),
                status_name(frame.status), frame.registered ? 1 : 0);
  std::string line = text;
  if (!frame.T_map_body) return line + std::string(fields_of_pose, ',') + "\n";
  const Eigen::Vector3d& t = frame.T_map_body->translation();
  const auto& q = frame.T_map_body->rotation().quaternion();
  std::snprintf(text, sizeof text, ",%d,%d,%.9g,%.9g,%.9g,%.12g,%.12g,%.12g,%.12g", frame.frame.value,
                frame.reference.value, t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w());
  line += text;
  for (int i = 0; i < 6; ++i)
    for (int j = i; j < 6; ++j) {
      std::snprintf(text, sizeof text, ",%.6g", frame.covariance(i, j));
      line += text;
    }
  return line + "\n";
}

double share(Index part, Index whole) { return whole > 0 ? static_cast<double>(part) / whole : 0.0; }

}  // namespace

const char* status_name(LocalizationStatus status) {
  switch (status) {
    case LocalizationStatus::searching:
      return "searching";
    case LocalizationStatus::tracking:
      return "tracking";
    case LocalizationStatus::uncertain:
      return "uncertain";
    case LocalizationStatus::lost:
      return "lost";
  }
  return "unknown";
}

void write_localizations(const FileTarget& target, std::span<const Localization> frames) {
  AtomicFile file(target);
  file.write(head_of_localizations());
  for (const Localization& frame : frames) file.write(row_of(frame));
  file.commit();
}

Trajectory localized_poses(std::span<const Localization> frames, bool tracked_only) {
  Trajectory poses;
  for (const Localization& frame : frames) {
    if (!frame.T_map_body || (tracked_only && frame.status != LocalizationStatus::tracking)) continue;
    poses.times.push_back(frame.time);
    poses.poses.push_back(*frame.T_map_body);
  }
  return poses;
}

void write_localization_summary(const FileTarget& target, const LocalizationRun& run) {
  nlohmann::ordered_json summary;
  const LocalizerCounts& counts = run.counts;
  summary["frames"] = counts.frames;
  summary["tracked"] = counts.tracked;
  summary["uncertain"] = counts.uncertain;
  summary["lost"] = counts.lost;
  summary["lost_share"] = share(counts.lost, counts.tracked + counts.uncertain + counts.lost);  // after the first fix
  summary["seconds_to_first_fix"] = run.first_fix ? nlohmann::ordered_json(*run.first_fix) : nullptr;
  summary["cold_starts"] = counts.starts;
  summary["losses"] = counts.losses;
  summary["place_searches"] = counts.searches;
  summary["registrations"] = counts.registrations;
  summary["refused_registrations"] = counts.refusals;
  if (run.errors) {
    summary["errors"]["poses"] = run.errors->translation_errors.size();
    summary["errors"]["translation_rmse"] = run.errors->translation.rmse;
    summary["errors"]["rotation_rmse_deg"] = run.errors->rotation.rmse * 180 / 3.14159265358979;
  }
  summary["interrupted"] = run.interrupted;
  summary["data_seconds"] = run.data_seconds;
  summary["wall_seconds"] = run.wall_seconds;
  for (const support::StageTime& stage : run.stages)
    summary["stages"].push_back({{"stage", stage.stage}, {"seconds", stage.total}, {"median", stage.p50}});
  AtomicFile file(target);
  file.write(summary.dump(2) + "\n");
  file.commit();
}

}  // namespace chainslam::mapper
