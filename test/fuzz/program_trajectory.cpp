#include "fuzz/input.hpp"
#include "mapper/trajectory_file.hpp"

// What the program reads whose format it tells by content: TUM, KITTI, EuRoC and NCLT.

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace chainslam::mapper;
  return chainslam::test::fuzz(data, size, "input.txt",
                               [](const auto& path) { static_cast<void>(read_trajectory(path, NcltPoses::imu)); });
}
