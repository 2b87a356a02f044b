// LiDAR-inertial odometry on packets of one's own: IMU samples and scans in the order in which they are complete.
// Usage: example_odometry_of_packets [IMU SCAN...]: IMU has lines `t gx gy gz ax ay az` in s, rad/s and m/s^2; scans
// are .pcd or .ply files named by the seconds at which they start, with time offsets. Prints the poses as TUM lines.
#include <chainslam/io/cloud_file.hpp>
#include <chainslam/io/input_file.hpp>
#include <chainslam/odometry/lidar_inertial_odometry.hpp>
#include <cstdio>

#include "generated/circle_drive.hpp"

using namespace chainslam;

std::vector<Packet> read_packets(std::span<char*> files) {
  std::vector<Packet> packets;
  InputFile imu(files[0]);
  while (const auto line = imu.read_line()) {
    LineFields fields(imu, *line);
    ImuSample sample{.time = fields.time_in_seconds("t")};
    for (double& rate : sample.gyro) rate = fields.number("gyro");
    for (double& force : sample.accel) force = fields.number("accel");
    packets.push_back(sample);
  }
  for (const char* file : files.subspan(1)) {
    LidarScan scan;
    scan.cloud = read_cloud(file);
    scan.time = scan.end = Timestamp::from_seconds(std::stod(std::filesystem::path(file).stem().string()));
    for (const float offset : scan.cloud.time_offsets) scan.end = std::max(scan.end, scan.time + seconds(offset));
    packets.push_back(scan);
  }
  std::ranges::stable_sort(packets, {}, available_at);
  return packets;
}

int main(int count, char** arguments) try {
  const bool given = count > 2;
  const std::vector<Packet> packets =
      given ? read_packets({arguments + 1, static_cast<std::size_t>(count - 1)}) : generated::circle_drive();

  LidarInertialOdometry<> odometry({.T_body_lidar = SE3d()});  // the LiDAR's pose in the IMU's frame
  double error = 0;
  const auto print = [&](const Frame& frame) {
    const Eigen::Vector3d p = frame.T_odom_body.translation();
    const auto q = frame.T_odom_body.rotation().quaternion();
    std::printf("%.3f %.4f %.4f %.4f %.6f %.6f %.6f %.6f\n", frame.time.to_seconds(), p.x(), p.y(), p.z(), q.x(), q.y(),
                q.z(), q.w());
    static const SE3d T_hall_odom = generated::T_hall_body(frame.time.to_seconds());  // the first pose is the origin
    error = (T_hall_odom * p - generated::T_hall_body(frame.time.to_seconds()).translation()).norm();
  };
  for (const Packet& packet : packets)
    if (const auto frame = odometry.process(packet)) print(*frame);
  while (const auto frame = odometry.flush()) print(*frame);
  const auto counts = odometry.counts();
  std::printf("# frames %d, lost %d, degenerate %d\n", static_cast<int>(counts.frames),
              static_cast<int>(counts.lost_scans), static_cast<int>(counts.degenerate_scans));
  if (!given) std::printf("# error %.3f m at the end of 6 m\n", error);
} catch (const std::exception& failure) {
  return std::fprintf(stderr, "%s\n", failure.what()), 2;
}
