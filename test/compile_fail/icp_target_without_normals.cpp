// expect: PointToPlane needs a target with `normal(i)`, such as IndexedCloud
#include <vector>

#include "chainslam/registration/icp.hpp"
#include "chainslam/search/indexed_cloud.hpp"

#ifdef CHAINSLAM_RIGHT
using Target = chainslam::IndexedCloud<>;
#else
using Target = chainslam::KdTree<float>;
#endif

int main() {
  const std::vector<Eigen::Vector3f> scan;
  (void)chainslam::PointToPlaneIcp{}.align(scan, Target(), chainslam::SE3d());
}
