// expect: IncrementalSmoother: name this type of factor in the smoother's Extra
// A factor of a type that the smoother was not told of.
#include "chainslam/factor_graph/incremental_smoother.hpp"

using namespace chainslam;
using Closure = BetweenFactor<SE3d, Cauchy>;

#ifdef CHAINSLAM_RIGHT
void add(IncrementalSmoother<SE3d, Closure>& smoother, const Closure& closure) { smoother.add(closure); }
#else
void add(IncrementalSmoother<SE3d>& smoother, const Closure& closure) { smoother.add(closure); }
#endif
