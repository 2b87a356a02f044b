#include "fuzz/input.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  return chainslam::test::fuzz(data, size, "helipr/LiDAR/Velodyne/1691936500000000000.bin", [](const auto& path) {
    chainslam::test::read_all(path.parent_path().parent_path().parent_path());
  });
}
