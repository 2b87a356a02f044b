#include "chainslam/io/pcd.hpp"
#include "fuzz/input.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  return chainslam::test::fuzz(data, size, "input.pcd",
                               [](const auto& path) { static_cast<void>(chainslam::read_pcd_file(path)); });
}
