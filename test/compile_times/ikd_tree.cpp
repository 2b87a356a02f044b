// A tree that grows.
#include <chainslam/search/ikd_tree.hpp>
#include <vector>

int main() {
  std::vector<Eigen::Vector3f> points(100, Eigen::Vector3f::Zero());
  chainslam::IkdTree<float> tree;
  tree.insert(points);
  return static_cast<int>(tree.knn<5>(points[0]).found().size());
}
