// expect: PointToPlane needs a target with `normal(i)`, such as IndexedCloud
#include <vector>

#include "chainslam/registration/icp.hpp"
#include "chainslam/search/kd_tree.hpp"

int main() {
  const std::vector<Eigen::Vector3f> scan;
  const chainslam::KdTree<float> target(scan);
  (void)chainslam::PointToPlaneIcp{}.align(scan, target, chainslam::SE3d());
}
