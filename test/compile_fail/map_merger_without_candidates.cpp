// expect: MapMerger: Candidates needs `std::vector<KeyframeId> find(map, query)`, as in GnssCandidates
// Candidates that look for loops: they know the keyframes' positions, but not the sessions.
#include "chainslam/slam/closure_candidates.hpp"
#include "chainslam/slam/map_merger.hpp"

#ifdef CHAINSLAM_RIGHT
using Candidates = chainslam::GnssCandidates;
#else
using Candidates = chainslam::ProximityCandidates;
#endif

int main() { (void)sizeof(chainslam::MapMerger<Candidates>); }
