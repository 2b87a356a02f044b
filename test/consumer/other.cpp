#include <chainslam/chainslam.hpp>

Eigen::Vector3d moved_elsewhere(const chainslam::SE3d& T, const Eigen::Vector3d& p) {
  return T.rotation() * p + T.translation();
}
