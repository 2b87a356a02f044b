#include "datasets/kitti_calibration.hpp"
#include "fuzz/input.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  return chainslam::test::fuzz(data, size, "calib.txt", [](const auto& path) {
    static_cast<void>(chainslam::datasets::KittiCalibration(path).matrix("Tr"));
  });
}
