#include "chainslam/slam/map_graph.hpp"

namespace chainslam {

template class IncrementalGnc<IncrementalSmoother<SE3d>>;
template class MapGraph<>;
template ConvergeReport MapGraph<>::converge(const Serial&);
template ConvergeReport MapGraph<>::converge(const ThreadPool&);

}  // namespace chainslam
