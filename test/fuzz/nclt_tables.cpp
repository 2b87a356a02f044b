#include "fuzz/input.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  return chainslam::test::fuzz_folder(
      data, size, {"ms25.csv", "gps.csv", "gps_rtk.csv", "groundtruth.csv", "velodyne_sync/1326030975000000.bin"},
      chainslam::test::read_all);
}
