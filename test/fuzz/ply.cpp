#include "chainslam/io/ply.hpp"
#include "fuzz/input.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  return chainslam::test::fuzz(data, size, "input.ply",
                               [](const auto& path) { static_cast<void>(chainslam::read_ply_file(path)); });
}
