#include "chainslam/factor_graph/incremental_smoother.hpp"

namespace chainslam {

template class IncrementalSmoother<SE3d>;
template UpdateReport IncrementalSmoother<SE3d>::update(const Serial&);
template ConvergeReport IncrementalSmoother<SE3d>::converge(const ConvergeOptions<>&, const Serial&);
template ConvergeReport IncrementalSmoother<SE3d>::converge(const ConvergeOptions<NoRestart>&, const Serial&);
template FactorId IncrementalSmoother<SE3d>::add(const PriorFactor<SE3d>&);
template FactorId IncrementalSmoother<SE3d>::add(const BetweenFactor<SE3d>&);

}  // namespace chainslam
