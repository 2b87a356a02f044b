#include "chainslam/search/ikd_tree.hpp"
#include "chainslam/search/indexed_cloud.hpp"
#include "chainslam/search/kd_tree.hpp"

namespace chainslam {

template class KdTree<float>;
template KdTree<float>::KdTree(const PointCloud<float>&);
template class IkdTree<float>;

}  // namespace chainslam
