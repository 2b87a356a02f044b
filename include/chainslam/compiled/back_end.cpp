#include "chainslam/slam/back_end.hpp"

namespace chainslam {

template class BackEnd<>;
template KeyframeId BackEnd<>::add(Keyframe, const Serial&);
template void BackEnd<>::add(const GnssFix&, const Serial&);
template KeyframeId BackEnd<>::add(Keyframe, const ThreadPool&);
template void BackEnd<>::add(const GnssFix&, const ThreadPool&);
template void BackEnd<>::begin_session(std::string, const Serial&);
template void BackEnd<>::begin_session(std::string, const ThreadPool&);
template std::shared_ptr<const SlamMap> BackEnd<>::finish(const Serial&);
template std::shared_ptr<const SlamMap> BackEnd<>::finish(const ThreadPool&);
template std::shared_ptr<const SlamMap> BackEnd<>::release(const Serial&);
template std::shared_ptr<const SlamMap> BackEnd<>::release(const ThreadPool&);

}  // namespace chainslam
