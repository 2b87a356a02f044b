#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cstddef>
#include <memory>
#include <string>

#include "chainslam/core/random.hpp"
#include "chainslam/odometry/lidar_inertial_odometry.hpp"
#include "chainslam/odometry/lidar_odometry.hpp"
#include "chainslam/odometry/self_calibrating.hpp"
#include "chainslam/search/ikd_tree.hpp"
#include "chainslam/trajectory/kitti_errors.hpp"
#include "support/drive_run.hpp"
#include "support/property.hpp"
#include "support/quick.hpp"
#include "support/semi_real_drives.hpp"

// Simulated scans on real drives with their real IMU data, whose clock is 66 ms late and whose measurements have gaps;
// with the settings that users get. bench/odometry_table.sh runs all five drives from end to end, and a hundred starts.

using namespace chainslam;

namespace {

using Default = SelfCalibrating<LidarInertialOdometry<>>;  // what the program runs
using FastLio2 = LidarInertialOdometry<IkdTree<float, NearestToCenter>, Trivial>;

struct DriveErrors {
  double ape = 0;    ///< metres
  double kitti = 0;  ///< percent; 0 if the drive is too short
};

DriveErrors errors_of(const test::Drive& drive, const test::DriveRun& run) {
  CHECK(run.counts.lost_scans == 0);
  CHECK(run.counts.frames == run.counts.scans);
  const MatchedTrajectories poses = test::counted_poses(drive, run.lidar);
  return {ape(poses.reference, poses.estimate).translation.rmse,
          100 * kitti_errors(poses.reference, poses.estimate).translation};
}

template <class Odometry>
DriveErrors errors_on(const test::Drive& drive, typename Odometry::Options options = {}) {
  options.T_body_lidar = drive.T_body_lidar;
  return errors_of(drive, test::run_drive<Odometry>(drive, options));
}

/// On all of a drive, whose scans would not fit into memory.
template <class Odometry>
DriveErrors errors_on(const test::KittiSequence& sequence, typename Odometry::Options options = {}) {
  const auto semi_real = test::semi_real_drive(sequence);
  const test::Drive drive = test::without_scans(*semi_real);
  options.T_body_lidar = drive.T_body_lidar;
  return errors_of(drive, test::run_packets<Odometry>([&] { return semi_real->next(); }, options));
}

}  // namespace

TEST_SUITE("odometry on semi-real drives") {
  // At 8 to 15 m/s, the first tenth of a second as quiet as at rest.
  TEST_CASE("started at a steady speed, which the measurements do not show" * doctest::skip(test::quick())) {
    struct Start {
      test::KittiSequence sequence;
      Index scan;
    };
    for (const Start& start : {Start{test::kitti_imu_sequences[0], 0}, Start{test::kitti_imu_sequences[4], 1315},
                               Start{test::kitti_imu_sequences[2], 674}}) {
      if (start.scan == 674 && !test::full()) break;
      CAPTURE(std::string(start.sequence.name));
      const auto semi_real = test::semi_real_drive(start.sequence);
      if (!semi_real) return;
      const test::Drive drive = test::part_of(*semi_real, start.scan, 40);
      const DriveErrors lidar = errors_on<LidarOdometry<>>(drive), standard = errors_on<Default>(drive);
      CAPTURE(lidar.ape);
      CHECK(test::no_worse(standard.ape, lidar.ape));
    }
  }

  // What is followed by an IMU that is 66 ms late until its clock is known stays in the map: 0.10 m after 4 s of that.
  TEST_CASE("started at a turn, 20 s are no worse than by scans alone" * doctest::skip(test::quick())) {
    const auto semi_real = test::semi_real_drive(test::kitti_imu_sequences[0]);
    if (!semi_real) return;
    const test::Drive drive = test::part_of(*semi_real, 1987, 200);
    const DriveErrors lidar = errors_on<LidarOdometry<>>(drive), standard = errors_on<Default>(drive);
    MESSAGE("simulated scans, real IMU: lidar ", lidar.ape, " m, lidar_inertial ", standard.ape, " m");
    CHECK(test::no_worse(standard.ape, lidar.ape));
  }

  // KITTI's truth, which the simulated scans follow, accelerates by up to 0.16 m/s^2 per sqrt(Hz) at one second where
  // the accelerometer measured nothing: the same accelerometer and real scans differ by 0.01 to 0.04. Gravity learnt
  // from it as if it were good to 0.02 tilts the way by half a degree: 0.06 and 0.05 m at these starts.
  TEST_CASE("an accelerometer that does not suit the scans makes 20 s no worse" * doctest::skip(test::quick())) {
    const auto semi_real = test::semi_real_drive(test::kitti_imu_sequences[0]);
    if (!semi_real) return;
    for (const Index start : {3393, 4144}) {
      if (start != 3393 && !test::full()) break;
      const test::Drive drive = test::part_of(*semi_real, start, 200);
      const DriveErrors lidar = errors_on<LidarOdometry<>>(drive), standard = errors_on<Default>(drive);
      MESSAGE("simulated scans, real IMU: lidar ", lidar.ape, " m, lidar_inertial ", standard.ape, " m");
      CHECK(test::no_worse(standard.ape, lidar.ape));
    }
  }

  TEST_CASE("KITTI 06: the IMU makes it more accurate than scans alone and than FAST-LIO2, which lose nothing either" *
            doctest::skip(!test::full())) {
    const test::KittiSequence sequence = test::kitti_imu_sequences[2];
    if (!test::semi_real_drive(sequence)) return;
    const DriveErrors lidar = errors_on<LidarOdometry<>>(sequence);
    const DriveErrors fast_lio2 = errors_on<FastLio2>(sequence, fast_lio2_options());
    const DriveErrors standard = errors_on<Default>(sequence);
    MESSAGE("simulated scans, real IMU: lidar ", lidar.ape, " m, ", lidar.kitti, " %; fast_lio2 ", fast_lio2.ape,
            " m, ", fast_lio2.kitti, " %; lidar_inertial ", standard.ape, " m, ", standard.kitti, " %");
    CHECK(standard.kitti <= std::min(lidar.kitti, fast_lio2.kitti));
    CHECK(standard.kitti < 0.6);
    CHECK(standard.ape <= std::min(lidar.ape, fast_lio2.ape));
  }

  TEST_CASE("started at random times, 20 s are no worse than by scans alone" * doctest::skip(!test::full())) {
    std::array<std::unique_ptr<simulator::RecordedDrive>, test::kitti_imu_sequences.size()> drives;
    for (std::size_t i = 0; i < drives.size(); ++i) {
      drives[i] = test::semi_real_drive(test::kitti_imu_sequences[i]);
      if (!drives[i]) return;
    }
    test::for_all(2 * static_cast<int>(drives.size()), [&](Rng& rng, int size) {
      constexpr Index scans = 200;
      const std::size_t i = static_cast<std::size_t>(size) % drives.size();
      const Index first = rng.uniform_index(drives[i]->scan_count() - scans + 1);
      CAPTURE(std::string(test::kitti_imu_sequences[i].name));
      CAPTURE(first);
      const test::Drive drive = test::part_of(*drives[i], first, scans);
      const DriveErrors lidar = errors_on<LidarOdometry<>>(drive), standard = errors_on<Default>(drive);
      CAPTURE(lidar.ape);
      CAPTURE(standard.ape);
      CHECK(test::no_worse(standard.ape, lidar.ape));
    });
  }
}
