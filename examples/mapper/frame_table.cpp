#include "frame_table.hpp"

#include <array>
#include <cstdio>
#include <string>

#include "chainslam/io/detail/pose_fields.hpp"

namespace chainslam::mapper {

namespace {

const char* name_of(FrameStatus status) {
  switch (status) {
    case FrameStatus::good:
      return "good";
    case FrameStatus::degenerate:
      return "degenerate";
    case FrameStatus::lost:
      return "lost";
  }
  return "unknown";
}

const char* name_of(const std::optional<ImuUse>& use) {
  if (!use) return "";
  switch (*use) {
    case ImuUse::all:
      return "all";
    case ImuUse::gyroscope:
      return "gyroscope";
    case ImuUse::rough_gyroscope:
      return "rough_gyroscope";
    case ImuUse::none:
      return "none";
  }
  return "unknown";
}

std::string head() {
  constexpr std::array axes{"x", "y", "z", "rx", "ry", "rz"};
  std::string text =
      "session,time_ns,status,map_restarted,after_gap,imu_use,doubtful,points,matches,iterations,residual_rms_m,"
      "odom_x,odom_y,odom_z,odom_qx,odom_qy,odom_qz,odom_qw";
  for (std::size_t i = 0; i < axes.size(); ++i)
    for (std::size_t j = i; j < axes.size(); ++j) text += std::string(",cov_") + axes[i] + "_" + axes[j];
  return text + "\n";
}

std::string row(const FrameRecord& frame) {
  const FrameHealth& health = frame.health;
  const Eigen::Vector3d& t = frame.T_odom_body.translation();
  const auto& q = frame.T_odom_body.rotation().quaternion();
  char text[512];
  // The residual as map files keep it, so that exports of a map give the same table.
  std::snprintf(text, sizeof text, "%d,%lld,%s,%d,%d,%s,%d,%d,%d,%d,%.6g,%.9g,%.9g,%.9g,%.12g,%.12g,%.12g,%.12g",
                frame.session.value, static_cast<long long>(frame.time.nanoseconds()), name_of(health.status),
                health.map_restarted, health.after_gap, name_of(health.imu_use), health.doubtful(), health.points,
                health.matches, health.iterations, static_cast<float>(health.residual_rms), t.x(), t.y(), t.z(), q.x(),
                q.y(), q.z(), q.w());
  std::string line = text;
  for (const float entry : frame.covariance.upper()) {
    std::snprintf(text, sizeof text, ",%.6g", static_cast<double>(entry));
    line += text;
  }
  return line + "\n";
}

}  // namespace

void write_frames(const FileTarget& target, const SlamMap& map) {
  AtomicFile file(target);
  file.write(head());
  for (std::size_t i = 0; i < map.frames.size(); ++i) {
    detail::require_finite(target, "frame", i, map.frames[i].T_odom_body);
    file.write(row(map.frames[i]));
  }
  file.commit();
}

}  // namespace chainslam::mapper
