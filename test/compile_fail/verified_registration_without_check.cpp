// expect: VerifiedRegistration: Check needs `Verification verify(source, target, T_target_source, viewpoints, executor)
// expect: see chainslam/registration/verified_registration.hpp
#include "chainslam/registration/verified_registration.hpp"

#ifdef CHAINSLAM_RIGHT
using Check = chainslam::Verifier;
#else
struct Check {
  double max_distance = 1.0;
};
#endif

int main() {
  (void)sizeof(
      chainslam::VerifiedRegistration<chainslam::GraphConsensus<>,
                                      chainslam::CoarseToFine<chainslam::Icp<chainslam::PointToPlane>>, Check>);
}
