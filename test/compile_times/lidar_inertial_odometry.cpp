// Odometry by scans and inertial readings.
#include <chainslam/odometry/lidar_inertial_odometry.hpp>

int main() {
  chainslam::LidarInertialOdometry<> odometry;
  return odometry.process(chainslam::ImuSample{}) ? 0 : 1;
}
