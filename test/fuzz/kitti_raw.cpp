#include "fuzz/input.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  return chainslam::test::fuzz_folder(
      data, size,
      {"2011_09_26/drive/velodyne_points/timestamps.txt", "2011_09_26/drive/oxts/timestamps.txt",
       "2011_09_26/drive/oxts/data/0000000000.txt", "2011_09_26/calib_imu_to_velo.txt",
       "2011_09_26/drive/velodyne_points/data/0000000000.bin"},
      [](const auto& path) { chainslam::test::read_all(path / "2011_09_26/drive"); });
}
