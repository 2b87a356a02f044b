// expect: MapMerger: Registration needs `GlobalAlignResult align(source, target, executor) const`, as in
// A registration that needs a guess: between two frames there is none.
#include "chainslam/registration/icp.hpp"
#include "chainslam/slam/map_merger.hpp"

#ifdef CHAINSLAM_RIGHT
using Registration = chainslam::FeatureRegistration<>;
#else
using Registration = chainslam::Icp<>;
#endif

int main() { (void)sizeof(chainslam::MapMerger<chainslam::GnssCandidates, Registration>); }
