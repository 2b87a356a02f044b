// expect: BackEnd: with a Chainer or a Merger, Closer needs `LoopClosure align(keyframes, from, to, guess, executor)`
// A closer that finds closures but cannot be asked for one: enough without chaining and merging only.
#include "chainslam/slam/back_end.hpp"

using namespace chainslam;

struct MyCloser {
  template <Executor E>
  std::vector<LoopClosure> close(std::span<const Keyframe>, const PositionIndex&, const E&) {
    return {};
  }
};

#ifdef CHAINSLAM_RIGHT
using MyBackEnd = BackEnd<MyCloser, NoChaining, NoMerging>;
#else
using MyBackEnd = BackEnd<MyCloser, ChainedCloser, NoMerging>;
#endif

int main() { (void)sizeof(MyBackEnd); }
