#include "fuzz/input.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  return chainslam::test::fuzz(data, size, "sync/velodyne_sync/1326030975000000.bin",
                               [](const auto& path) { chainslam::test::read_all(path.parent_path().parent_path()); });
}
