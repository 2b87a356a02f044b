// expect: executor.for_chunks(count, grain, body)
// An executor that cannot run chunks.
#include "chainslam/core/executor.hpp"

struct MyExecutor {
#ifdef CHAINSLAM_RIGHT
  template <class Body>
  void for_chunks(chainslam::Index count, chainslam::Index grain, Body&& body) const {
    chainslam::Serial{}.for_chunks(count, grain, body);
  }
#else
  template <class Body>
  void parallel_for(chainslam::Index count, Body&& body) const;
#endif
};

int sum(const MyExecutor& executor) {
  return chainslam::reduce_chunks(
      executor, 100, 10, 0, [](int begin, int end) { return end - begin; }, [](int a, int b) { return a + b; });
}
