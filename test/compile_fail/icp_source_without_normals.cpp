// expect: PlaneToPlane needs a source with normals, such as PointCloud
#include <vector>

#include "chainslam/registration/icp.hpp"
#include "chainslam/search/indexed_cloud.hpp"

#ifdef CHAINSLAM_RIGHT
using Source = chainslam::PointCloud<float>;
#else
using Source = std::vector<Eigen::Vector3f>;
#endif

int main() { (void)chainslam::Gicp{}.align(Source(), chainslam::IndexedCloud<>(), chainslam::SE3d()); }
