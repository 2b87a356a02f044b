#include <chainslam/chainslam.hpp>

Eigen::Vector3d moved_elsewhere(const chainslam::SE3d& T, const Eigen::Vector3d& p);

int main() {
  const chainslam::SE3d T = chainslam::SE3d::exp(chainslam::Vector6d::Constant(0.1));
  const Eigen::Vector3d p(1, 2, 3);
  const Eigen::Vector3d difference = T * p - moved_elsewhere(T, p);
  return difference.norm() < 1e-12 ? 0 : 1;
}
