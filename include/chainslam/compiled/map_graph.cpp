#include "chainslam/slam/map_graph.hpp"

namespace chainslam {

template class IncrementalSmoother<SE3d, BetweenFactor<SE3d, Cauchy>>;
template UpdateReport IncrementalSmoother<SE3d, BetweenFactor<SE3d, Cauchy>>::update(const Serial&);
template ConvergeReport IncrementalSmoother<SE3d, BetweenFactor<SE3d, Cauchy>>::converge(const ConvergeOptions&,
                                                                                         const Serial&);
template class MapGraph<>;

}  // namespace chainslam
