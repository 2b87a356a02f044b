#include "fuzz/input.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  return chainslam::test::fuzz_folder(data, size,
                                      {"xsens_imu.csv", "gps.csv", "global_pose.csv", "Ouster/1561000444390857630.bin"},
                                      chainslam::test::read_all);
}
