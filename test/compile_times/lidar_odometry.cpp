// Odometry by scans.
#include <chainslam/odometry/lidar_odometry.hpp>

int main() {
  chainslam::LidarOdometry<> odometry;
  return odometry.process(chainslam::LidarScan{}) ? 0 : 1;
}
