// The back end of a mapper.
#include <chainslam/slam/back_end.hpp>

int main() {
  chainslam::BackEnd<> back_end;
  back_end.begin_session("morning");
  back_end.add(chainslam::Keyframe{});
  return back_end.finish()->keyframes.empty() ? 1 : 0;
}
