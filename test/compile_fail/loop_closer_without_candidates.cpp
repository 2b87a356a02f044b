// expect: LoopCloser: Candidates needs `std::vector<KeyframeId> find(keyframes, index, query)`
#include "chainslam/slam/loop_closer.hpp"

struct MyCandidates {};

#ifdef CHAINSLAM_RIGHT
using Candidates = chainslam::ProximityCandidates;
#else
using Candidates = MyCandidates;
#endif

int main() { (void)sizeof(chainslam::LoopCloser<Candidates>); }
