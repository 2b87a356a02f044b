// expect: to align plain clouds, include chainslam/registration/align.hpp
// alone: the whole library has that header
#include <vector>

#include "chainslam/registration/icp.hpp"
#ifdef CHAINSLAM_RIGHT
#include "chainslam/registration/align.hpp"
#endif

int main() {
  const std::vector<Eigen::Vector3f> scan;
  (void)chainslam::PointToPlaneIcp{}.align(scan, scan);
}
