#include "fuzz/input.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  return chainslam::test::fuzz_folder(
      data, size,
      {"v1.0/scene.json", "v1.0/sample.json", "v1.0/sensor.json", "v1.0/calibrated_sensor.json",
       "v1.0/sample_data.json", "v1.0/ego_pose.json", "v1.0/log.json", "sweeps/a.pcd.bin"},
      chainslam::test::read_all);
}
