#include <doctest/doctest.h>

#include <cstddef>
#include <cstdio>
#include <vector>

#include "slam/nclt_drives.hpp"
#include "support/graph_nees.hpp"
#include "support/real_data.hpp"

namespace chainslam {

TEST_SUITE("slam/odometry_nees") {
  // Odometry and truth shake by about 0.6 degrees there from frame to frame, which does not add up: whatever the
  // rotations of independent steps, they look too tight over 1 m or too loose over 100 m. Each bound fails if all noise
  // is three times as large or as small.
  TEST_CASE("a real recording that says nothing of its errors is off by as much as the back end expects") {
    const auto folder = test::real_data("trajectories/nclt");
    if (!folder) return;
    for (const test::RealDrive& drive : test::read_nclt_drives(*folder, 0)) {
      std::vector<FrameRecord> frames;
      for (std::size_t i = 0; i < drive.times.size(); ++i)
        frames.push_back({.session = {}, .time = drive.times[i], .T_odom_body = drive.odometry[i]});
      const test::GraphNees nees(frames, drive.truth, 3.0);
      const test::NeesRatio one = nees.over(1), ten = nees.over(10), hundred = nees.over(100);
      std::printf(
          "FIGURE nclt, odometry's errors over expected, 1, 10, 100 m: translation %.2f %.2f %.2f, rotation %.2f "
          "%.2f %.2f\n",
          one.translation, ten.translation, hundred.translation, one.rotation, ten.rotation, hundred.rotation);
      REQUIRE(hundred.count > 500);
      for (const test::NeesRatio& ratio : {one, ten, hundred}) {
        CHECK(ratio.translation > 0.4);
        CHECK(ratio.translation < 1.1);
      }
      CHECK(one.rotation > 1.3);
      CHECK(one.rotation < 3.6);
      CHECK(ten.rotation > 0.9);
      CHECK(ten.rotation < 2.2);
      CHECK(hundred.rotation > 0.45);
      CHECK(hundred.rotation < 1.1);
    }
  }
}

}  // namespace chainslam
