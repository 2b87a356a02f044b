// expect: BasicRansac: Local needs `Hypothesis improve(points, hypothesis, max_distance) const`, as in Refit
// expect: see chainslam/registration/ransac.hpp
#include "chainslam/registration/ransac.hpp"

struct Local {
#ifdef CHAINSLAM_RIGHT
  chainslam::Hypothesis improve(const chainslam::MatchedPoints&, const chainslam::Hypothesis& found, double) const {
    return found;
  }
#endif
};

int main() { (void)sizeof(chainslam::BasicRansac<Local>); }
