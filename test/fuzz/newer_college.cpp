#include "fuzz/input.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  return chainslam::test::fuzz_folder(data, size,
                                      {"raw_format/imu.csv", "ground_truth/registered_poses.csv",
                                       "raw_format/ouster_scan/cloud_1583836591_182590976.pcd"},
                                      chainslam::test::read_all);
}
