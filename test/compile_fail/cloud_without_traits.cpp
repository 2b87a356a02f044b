// expect: CloudTraits<T>::size
// A cloud of the user's own has no CloudTraits.
#include "chainslam/search/kd_tree.hpp"

struct MyCloud {
  std::vector<Eigen::Vector3f> points;
};

#ifdef CHAINSLAM_RIGHT
template <>
struct chainslam::CloudTraits<MyCloud> {
  static std::size_t size(const MyCloud& cloud) { return cloud.points.size(); }
  static const Eigen::Vector3f& position(const MyCloud& cloud, std::size_t i) { return cloud.points[i]; }
};
#endif

chainslam::KdTree<> build(const MyCloud& cloud) { return chainslam::KdTree<>(cloud); }
