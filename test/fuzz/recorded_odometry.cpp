#include "fuzz/input.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  return chainslam::test::fuzz_folder(
      data, size,
      {"odometry.json", "frames.csv", "fixes.csv", "truth.tum", "times.txt", "odom_poses.txt", "Scans/0.pcd"},
      [](const auto& path) {
        const auto dataset = chainslam::datasets::open_dataset(path, {.recorded_intensities = true});
        while (dataset->next_frame()) static_cast<void>(dataset->take_fixes());
        static_cast<void>(dataset->truth());
      });
}
