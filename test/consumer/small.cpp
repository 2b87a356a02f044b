#include <chainslam/search/kd_tree.hpp>
#include <vector>

int main() {
  const std::vector<Eigen::Vector3f> points{{1, 2, 3}, {4, 5, 6}};
  const chainslam::KdTree<float> tree(points);
  return tree.size() == 2 ? 0 : 1;
}
