#pragma once

// `IncrementalSmoother`: its class, what is added to it, what can be asked of it, how it updates and converges, gives
// up variables, and is saved.
#include "chainslam/core/compiled.hpp"
#include "chainslam/factor_graph/detail/incremental_smoother_archive.hpp"
#include "chainslam/factor_graph/detail/incremental_smoother_changes.hpp"
#include "chainslam/factor_graph/detail/incremental_smoother_class.hpp"
#include "chainslam/factor_graph/detail/incremental_smoother_converge.hpp"
#include "chainslam/factor_graph/detail/incremental_smoother_marginalize.hpp"
#include "chainslam/factor_graph/detail/incremental_smoother_queries.hpp"
#include "chainslam/factor_graph/detail/incremental_smoother_update.hpp"

#ifdef CHAINSLAM_COMPILED
namespace chainslam {

extern template class IncrementalSmoother<SE3d>;
extern template UpdateReport IncrementalSmoother<SE3d>::update(const Serial&);
extern template ConvergeReport IncrementalSmoother<SE3d>::converge(const ConvergeOptions<>&, const Serial&);
extern template ConvergeReport IncrementalSmoother<SE3d>::converge(const ConvergeOptions<NoRestart>&, const Serial&);
extern template FactorId IncrementalSmoother<SE3d>::add(const PriorFactor<SE3d>&);
extern template FactorId IncrementalSmoother<SE3d>::add(const BetweenFactor<SE3d>&);

}  // namespace chainslam
#endif
