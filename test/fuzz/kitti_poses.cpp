#include "chainslam/io/trajectory_file.hpp"
#include "fuzz/input.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  return chainslam::test::fuzz(data, size, "poses.txt",
                               [](const auto& path) { static_cast<void>(chainslam::read_kitti_poses(path)); });
}
