#include "chainslam/factor_graph/batch_optimizer.hpp"

namespace chainslam {

template OptimizeReport optimize(PoseGraph&, const GaussNewton&);
template OptimizeReport optimize(PoseGraph&, const LevenbergMarquardt&);
template OptimizeReport optimize(PoseGraph&, const Dogleg&);

}  // namespace chainslam
