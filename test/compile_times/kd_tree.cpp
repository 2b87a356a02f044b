// A tree of points that stay.
#include <chainslam/search/kd_tree.hpp>
#include <vector>

int main() {
  const std::vector<Eigen::Vector3f> points(100, Eigen::Vector3f::Zero());
  const chainslam::KdTree<float> tree(points);
  return static_cast<int>(tree.knn<5>(points[0]).found().size());
}
