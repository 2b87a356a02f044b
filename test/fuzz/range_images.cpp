#include "fuzz/input.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  return chainslam::test::fuzz_folder(
      data, size, {"velodyne_config.txt", "timestamps_start.txt", "timestamps_end.txt", "imu.cfg", "data/0.png"},
      chainslam::test::read_all);
}
