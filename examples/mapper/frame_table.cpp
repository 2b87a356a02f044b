#include "frame_table.hpp"

#include <array>
#include <cstdio>
#include <string>

#include "chainslam/io/detail/pose_fields.hpp"
#include "chainslam/io/detail/text.hpp"

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
  char text[256];
  std::snprintf(text, sizeof text, "%d,%lld,%s,%d,%d,%s,%d,%d,%d,%d", frame.session.value,
                static_cast<long long>(frame.time.nanoseconds()), name_of(health.status), health.map_restarted,
                health.after_gap, name_of(health.imu_use), health.doubtful(), health.points, health.matches,
                health.iterations);
  std::string line = text;
  const auto append = [&](double value, int digits) { detail::append_number(line += ',', value, digits); };
  append(static_cast<float>(health.residual_rms), 6);  // as map files keep it: exports of one give the same table
  for (int k = 0; k < 3; ++k) append(t[k], 9);
  for (const double part : {q.x(), q.y(), q.z(), q.w()}) append(part, 12);
  for (const float entry : frame.covariance.upper()) append(static_cast<double>(entry), 6);
  return line += '\n';
}

}  // namespace

void write_frames(const FileTarget& target, const SlamMap& map) {
  AtomicFile file(target);
  file.write(head());
  std::size_t i = 0;
  for (const FrameRecord& frame : map.frames) {
    detail::require_finite(target, "frame", i++, frame.T_odom_body);
    file.write(row(frame));
  }
  file.commit();
}

}  // namespace chainslam::mapper
