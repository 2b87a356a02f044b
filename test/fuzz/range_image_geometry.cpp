#include "datasets/range_image.hpp"
#include "fuzz/input.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  return chainslam::test::fuzz(data, size, "img.cfg", [](const auto& path) {
    static_cast<void>(chainslam::datasets::read_range_image_geometry(path));
  });
}
