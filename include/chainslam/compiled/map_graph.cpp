#include "chainslam/slam/map_graph.hpp"

namespace chainslam {

template class IncrementalGnc<IncrementalSmoother<SE3d>>;
template class MapGraph<>;

}  // namespace chainslam
