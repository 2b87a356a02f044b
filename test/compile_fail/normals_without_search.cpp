// expect: knn
// expect: NearestNeighborSearch
// Normals estimated with a search structure that finds nothing.
#include "chainslam/features/normals.hpp"
#include "chainslam/search/kd_tree.hpp"

struct MyIndex {
  using Scalar = float;
};

#ifdef CHAINSLAM_RIGHT
using Search = chainslam::KdTree<>;
#else
using Search = MyIndex;
#endif

void orient(chainslam::PointCloud<float>& cloud, const Search& search) { chainslam::estimate_normals(cloud, search); }
