#include "chainslam/slam/map_graph.hpp"

namespace chainslam {

template class IncrementalSmoother<SE3d, BetweenFactor<SE3d, Cauchy>>;
template UpdateReport IncrementalSmoother<SE3d, BetweenFactor<SE3d, Cauchy>>::update(const Serial&);
template ConvergeReport IncrementalSmoother<SE3d, BetweenFactor<SE3d, Cauchy>>::converge(
    const ConvergeOptions<NoRestart>&, const Serial&);
template FactorId IncrementalSmoother<SE3d, BetweenFactor<SE3d, Cauchy>>::add(const PriorFactor<SE3d>&);
template FactorId IncrementalSmoother<SE3d, BetweenFactor<SE3d, Cauchy>>::add(const BetweenFactor<SE3d>&);
template FactorId IncrementalSmoother<SE3d, BetweenFactor<SE3d, Cauchy>>::add(const BetweenFactor<SE3d, Cauchy>&);
template class MapGraph<>;

}  // namespace chainslam
