// expect: FeatureRegistration: Estimator needs `GlobalAlignResult align(source, target, matches, executor) const`
#include "chainslam/registration/feature_registration.hpp"

#ifdef CHAINSLAM_RIGHT
using Estimator = chainslam::Ransac;
#else
struct Estimator {
  double max_distance = 1.0;
};
#endif

int main() { (void)sizeof(chainslam::FeatureRegistration<Estimator>); }
