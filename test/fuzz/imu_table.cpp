#include "fuzz/input.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  return chainslam::test::fuzz_folder(data, size, {"imu.csv", "times.txt", "poses.txt", "T_body_lidar.txt", "0.bin"},
                                      chainslam::test::read_all);
}
