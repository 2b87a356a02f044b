#include "fuzz/input.hpp"
#include "mapper/recorded_input.hpp"
#include "support/configuration.hpp"

// What `simulate --trajectory` reads: the first byte says which options are given.

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace chainslam;
  if (size == 0) return 0;
  const unsigned choice = data[0];
  return test::fuzz_folder(data + 1, size - 1, {"trajectory.txt", "times.txt", "skip.txt", "imu.csv", "T.txt"},
                           [&](const auto& folder) {
                             mapper::SimulateArguments arguments;
                             arguments.trajectory = folder / "trajectory.txt";
                             if ((choice & 1U) != 0) arguments.times = folder / "times.txt";
                             if ((choice & 2U) != 0) arguments.skips = {(folder / "skip.txt").string(), "1:2"};
                             if ((choice & 4U) != 0) arguments.imu = folder / "imu.csv";
                             if ((choice & 8U) != 0) arguments.body_lidar = (folder / "T.txt").string();
                             if ((choice & 16U) != 0) arguments.camera_lidar = (folder / "T.txt").string();
                             if ((choice & 32U) != 0) arguments.rate = 10;
                             try {
                               static_cast<void>(mapper::read_recorded_input(arguments));
                             } catch (const support::ConfigError&) {
                             }
                           });
}
