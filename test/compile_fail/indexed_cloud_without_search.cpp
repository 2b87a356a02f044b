// expect: IndexedCloud: Search needs knn, within, position and size, as in KdTree
// expect: see chainslam/search/concepts.hpp
#include "chainslam/search/indexed_cloud.hpp"

struct MyIndex {
  using Scalar = float;
  explicit MyIndex(const chainslam::PointCloud<float>& cloud);
};

#ifdef CHAINSLAM_RIGHT
using Search = chainslam::KdTree<>;
#else
using Search = MyIndex;
#endif

int main() { (void)sizeof(chainslam::IndexedCloud<Search>); }
