#include "chainslam/io/g2o.hpp"
#include "fuzz/input.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  return chainslam::test::fuzz(data, size, "input.g2o",
                               [](const auto& path) { static_cast<void>(chainslam::read_g2o(path)); });
}
