// expect: RecordedOdometry: NextFrame needs `std::optional<Frame> operator()()`
#include "chainslam/odometry/odometry_source.hpp"

struct MyReader {
#ifdef CHAINSLAM_RIGHT
  std::optional<chainslam::Frame> operator()() { return std::nullopt; }
#else
  bool operator()(chainslam::Frame& frame);
#endif
};

int main() { (void)sizeof(chainslam::RecordedOdometry<MyReader>); }
