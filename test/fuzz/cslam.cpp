#include "chainslam/io/map_archive.hpp"
#include "fuzz/input.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  return chainslam::test::fuzz(data, size, "input.cslam",
                               [](const auto& path) { static_cast<void>(chainslam::load_map(path)); });
}
