#include "chainslam/slam/back_end.hpp"

namespace chainslam {

template class BackEnd<>;
template KeyframeId BackEnd<>::add(Keyframe, const Serial&);
template void BackEnd<>::add(const GnssFix&, const Serial&);
template KeyframeId BackEnd<>::add(Keyframe, const ThreadPool&);
template void BackEnd<>::add(const GnssFix&, const ThreadPool&);

}  // namespace chainslam
