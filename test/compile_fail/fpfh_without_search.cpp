// expect: knn
// expect: NearestNeighborSearch
// Features described with a search structure that finds nothing.
#include "chainslam/features/fpfh.hpp"
#include "chainslam/search/kd_tree.hpp"

struct MyIndex {
  using Scalar = float;
};

#ifdef CHAINSLAM_RIGHT
using Search = chainslam::KdTree<>;
#else
using Search = MyIndex;
#endif

void describe(const chainslam::PointCloud<float>& cloud, const Search& search) {
  (void)chainslam::estimate_fpfh(cloud, search);
}
