#include "datasets/extrinsic.hpp"
#include "fuzz/input.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  return chainslam::test::fuzz(data, size, "T_body_lidar.txt", [](const auto& path) {
    static_cast<void>(chainslam::datasets::find_extrinsic({path.parent_path()}));
  });
}
