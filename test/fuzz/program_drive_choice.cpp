#include <cstdlib>

#include "fuzz/input.hpp"
#include "mapper/drive_choice.hpp"

// simulation/options.json of a semi-real drive, from which its scans are made again. What was read and written again
// must be read as the same drive.

namespace {

bool same(const chainslam::mapper::DriveChoice& a, const chainslam::mapper::DriveChoice& b) {
  return a.lidar == b.lidar && a.columns == b.columns && a.lidar_height == b.lidar_height && a.seed == b.seed &&
         a.recorded_imu == b.recorded_imu && a.others == b.others && a.gnss == b.gnss &&
         a.T_body_lidar.translation() == b.T_body_lidar.translation() &&
         a.T_body_lidar.rotation().quaternion().isApprox(b.T_body_lidar.rotation().quaternion(), 1e-12);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace chainslam;
  return test::fuzz(data, size, "options.json", [](const auto& path) {
    const mapper::DriveChoice choice = mapper::read_choice(path);
    test::write_bytes(path, mapper::text_of(choice));
    if (!same(choice, mapper::read_choice(path))) std::abort();
  });
}
