#include <doctest/doctest.h>

#include <cstddef>
#include <string>
#include <vector>

#include "chainslam/odometry/lidar_inertial_odometry.hpp"
#include "chainslam/odometry/lidar_inertial_options.hpp"
#include "chainslam/odometry/lidar_odometry.hpp"
#include "chainslam/odometry/self_calibrating.hpp"
#include "chainslam/search/ikd_tree.hpp"
#include "chainslam/trajectory/trajectory.hpp"
#include "odometry/shared_drives.hpp"
#include "support/graph_nees.hpp"

// Whether the back end knows how far each odometry may be off, by real drives with truth.

namespace chainslam {
namespace {

/// Until the first span in which the truth itself is interpolated.
test::GraphNees nees_of(const test::Drive& drive, const test::DriveRun& run, const OdometryNoise& noise) {
  std::vector<FrameRecord> frames;
  std::vector<SE3d> truth;
  for (const FrameRecord& frame : run.frames) {
    if (!drive.not_counted.empty() && frame.time.to_seconds() >= drive.not_counted.front().begin) break;
    const auto T_world_lidar = pose_at(drive.reference, frame.time, seconds(1));
    if (!T_world_lidar) continue;
    frames.push_back(frame);
    truth.push_back(*T_world_lidar * drive.T_body_lidar.inverse());
  }
  return test::GraphNees(frames, truth, 3.0, {.odometry_noise = noise});
}

}  // namespace

TEST_SUITE("odometry/stated_noise") {
  // Over 1 m the truth itself is off by as much as odometry is, over 100 m there are few poses.
  TEST_CASE("each odometry is off on raw sweeps by as much as the back end expects") {
    const auto& drive = test::raw_sweeps();
    if (!drive) return;
    using Default = SelfCalibrating<LidarInertialOdometry<>>;
    using FastLio2 = LidarInertialOdometry<IkdTree<float, NearestToCenter>, Trivial>;
    FastLio2::Options as_published = fast_lio2_options();
    as_published.T_body_lidar = drive->T_body_lidar;
    const struct {
      std::string name;
      test::DriveRun run;
    } sources[] = {{"lidar", test::shared_run<LidarOdometry<>>(*drive, test::Feed::scans_alone)},
                   {"lidar_inertial", test::shared_run<Default>(*drive)},
                   {"fast_lio2", test::run_drive<FastLio2>(*drive, as_published)}};
    for (const auto& [name, run] : sources) {
      const test::GraphNees nees = nees_of(*drive, run, {});
      for (const double metres : {1.0, 10.0, 100.0}) {
        const test::NeesRatio ratio = nees.over(metres);
        MESSAGE(name, ", ", metres, " m: errors over expected, translation ", ratio.translation, ", rotation ",
                ratio.rotation, ", ", ratio.count, " poses");
        CHECK(ratio.translation > 0.4);
        CHECK(ratio.translation < 2.0);
        CHECK(ratio.rotation > 0.35);
        CHECK(ratio.rotation < 2.0);
      }
      // What odometry states of its frames, by itself: of a step, good for the direction that is weak, not for the
      // size.
      const OdometryNoise stated_alone{.translation = 1e-6,
                                       .translation_per_metre = 0,
                                       .rotation = 1e-7,
                                       .rotation_per_metre = 0,
                                       .rotation_per_radian = 0,
                                       .stated_translation = 1,
                                       .stated_rotation = 1};
      const test::NeesRatio stated = nees_of(*drive, run, stated_alone).over(1);
      MESSAGE(name, ": errors over stated, translation ", stated.translation, ", rotation ", stated.rotation);
      CHECK(stated.translation > 0.2);
      CHECK(stated.translation < 5);
      CHECK(stated.rotation > 0.1);
      CHECK(stated.rotation < 5);
    }
  }
}

}  // namespace chainslam
