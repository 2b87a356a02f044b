#include "chainslam/factor_graph/batch_optimizer.hpp"

namespace chainslam {

template OptimizeReport optimise(PoseGraph&, const GaussNewton&);
template OptimizeReport optimise(PoseGraph&, const LevenbergMarquardt&);
template OptimizeReport optimise(PoseGraph&, const Dogleg&);

}  // namespace chainslam
