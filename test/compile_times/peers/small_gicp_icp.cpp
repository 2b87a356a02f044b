// ICP of two clouds by small_gicp's templates.
#include <small_gicp/ann/kdtree.hpp>
#include <small_gicp/factors/icp_factor.hpp>
#include <small_gicp/factors/plane_icp_factor.hpp>
#include <small_gicp/points/point_cloud.hpp>
#include <small_gicp/registration/reduction.hpp>
#include <small_gicp/registration/registration.hpp>
#include <small_gicp/util/normal_estimation.hpp>

int main() {
  using namespace small_gicp;
  const auto source = std::make_shared<PointCloud>(), target = std::make_shared<PointCloud>();
  estimate_normals(*target, 10);
  const KdTree<PointCloud> tree(target);
  Registration<PointToPlaneICPFactor, SerialReduction> registration;
  return registration.align(*target, *source, tree, Eigen::Isometry3d::Identity()).converged ? 0 : 1;
}
