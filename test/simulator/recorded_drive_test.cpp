#include "simulator/recorded_drive.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "brute_force.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "datasets/dataset.hpp"
#include "simulator/recorded_files.hpp"
#include "support/files.hpp"
#include "support/kitti_drive.hpp"
#include "support/quick.hpp"

namespace chainslam::simulator {
namespace {

using chainslam::test::kitti_drive;
using chainslam::test::TemporaryFolder;

/// Twice round a figure of eight of 45 m by 90 m over hills, at 10 m/s: one crossing, and all driven twice.
Trajectory figure_of_eight() {
  Trajectory trajectory;
  for (double t = 0.0; t <= 52.0; t += 0.1) {
    const auto at = [](double time) {
      const double u = 2.0 * std::numbers::pi * time / 26.0;
      return Eigen::Vector3d(45.0 * std::sin(u), 45.0 * std::sin(u) * std::cos(u), 1.5 * std::cos(2.0 * u));
    };
    const Eigen::Vector3d ahead = at(t + 0.01) - at(t - 0.01);
    trajectory.times.push_back(Timestamp(seconds(100.0 + t)));
    trajectory.poses.push_back(
        SE3d(from_roll_pitch_yaw(0.01 * std::sin(t), -std::atan(ahead.z() / ahead.head<2>().norm()),
                                 std::atan2(ahead.y(), ahead.x())),
             at(t)));
  }
  return trajectory;
}

RecordedDriveOptions small_options() {
  RecordedDriveOptions options;
  options.lidar.firings_per_revolution = 60;
  options.lidar.T_body_lidar = SE3d(SO3d(), {0.8, 0.1, 0.8});
  return options;
}

/// Nothing within 1.2 m of the vehicle's middle, from 0.5 m to 2.1 m above the road, all along the path.
void check_clear(const RecordedDrive& drive) {
  constexpr float reach = 1.2F;
  int blocked = 0;
  for (const PathSample& sample : drive.path().samples())
    for (const double height : {0.5, 1.0, 1.6, 2.1})
      for (int turn = 0; turn < 12; ++turn) {
        const double angle = turn * std::numbers::pi / 6.0;
        const Eigen::Vector2d away(std::cos(angle), std::sin(angle));
        // From outside to the vehicle's middle as well: a ray that starts inside of a solid does not see it.
        const Eigen::Vector3d middle = sample.ground + height * Eigen::Vector3d::UnitZ();
        Eigen::Vector3d outside = middle;
        outside.head<2>() += static_cast<double>(reach) * away;
        const Eigen::Vector3f inward(static_cast<float>(-away.x()), static_cast<float>(-away.y()), 0.0F);
        for (const Ray& ray : {Ray{middle.cast<float>(), -inward, reach}, Ray{outside.cast<float>(), inward, reach}})
          blocked += drive.caster().cast(ray) ? 1 : 0;
      }
  CHECK(blocked == 0);
}

/// How far the ground lies from where the trajectory has its road, rms over the path, metres.
double ground_error(const RecordedDrive& drive) {
  double sum = 0.0;
  for (const PathSample& sample : drive.path().samples()) {
    const Eigen::Vector3d above = sample.ground + 2.0 * Eigen::Vector3d::UnitZ();
    const auto hit = drive.caster().cast({above.cast<float>(), -Eigen::Vector3f::UnitZ(), 10.0F});
    REQUIRE(hit);
    sum += std::pow(static_cast<double>(hit->distance) - 2.0, 2);
  }
  return std::sqrt(sum / static_cast<double>(drive.path().samples().size()));
}

}  // namespace

TEST_SUITE("simulator/recorded_drive") {
  TEST_CASE("nothing stands in the way, and the ground is where the vehicle drives, whatever the seed") {
    for (std::uint64_t seed = 1; seed <= (chainslam::test::quick() ? 2U : 6U); ++seed) {
      CAPTURE(seed);
      RecordedDriveOptions options = small_options();
      options.seed = seed;
      const RecordedDrive drive(figure_of_eight(), {}, options);
      check_clear(drive);
      CHECK(ground_error(drive) < 0.06);  // two passes, a crossing, and 6 mm of roughness
      CHECK(drive.caster().world().boxes.size() > 500);
      CHECK(drive.caster().world().ellipsoids.size() > 500);
    }
  }

  TEST_CASE("nothing stands in the way of a real drive, and its ground follows the recorded heights") {
    const auto recorded = kitti_drive("07", 0.1040);
    if (!recorded) return;
    RecordedDriveOptions options = small_options();
    options.lidar.T_body_lidar = kitti_T_lidar_imu().inverse();
    const RecordedDrive drive(recorded->trajectory, recorded->imu, options);
    CHECK(drive.path().length() == doctest::Approx(694.0).epsilon(0.01));  // KITTI 07's
    check_clear(drive);
    CHECK(ground_error(drive) < 0.02);
  }

  TEST_CASE("a path that comes back above itself is said to leave the ground") {
    CHECK(RecordedDrive(figure_of_eight(), {}, small_options()).off_ground(0.5) == 0.0);
    Trajectory climbing = figure_of_eight();  // 2 m from round to round
    for (std::size_t i = 0; i < climbing.size(); ++i)
      climbing.poses[i] = SE3d(SO3d(), {0.0, 0.0, 2.0 * static_cast<double>(i) / 260.0}) * climbing.poses[i];
    const RecordedDrive drive(climbing, {}, small_options());
    CHECK(drive.off_ground(0.5) > 0.8 * drive.path().length());  // half of the difference nearly everywhere
    CHECK(drive.off_ground(1.5) < 3.0);                          // where it ends, above two earlier passes
  }

  TEST_CASE("drives of one frame share a world, whichever is driven, and nothing stands in the way of any") {
    const Trajectory first = figure_of_eight();
    Trajectory second;  // from the crossing straight out of the first one's loops, an hour later
    for (double t = 0.0; t <= 12.0; t += 0.1) {
      second.times.push_back(Timestamp(seconds(3700.0 + t)));
      second.poses.push_back(SE3d(SO3d::exp({0.0, 0.0, std::numbers::pi / 2}), {0.0, -30.0 + 10.0 * t, 1.5}));
    }
    const RecordedDrive here(first, {}, small_options(), std::array{second});
    const RecordedDrive there(second, {}, small_options(), std::array{first});
    check_clear(here);  // all passes of both
    const World& world = here.caster().world();
    const World& same = there.caster().world();
    CHECK(world.ground.heights == same.ground.heights);
    REQUIRE(world.boxes.size() == same.boxes.size());
    for (std::size_t i = 0; i < world.boxes.size(); ++i) CHECK(world.boxes[i].center == same.boxes[i].center);
    CHECK(here.path().length() == doctest::Approx(here.length() + there.length()).epsilon(1e-3));
    CHECK(there.length() == doctest::Approx(120.0).epsilon(0.02));
    // Both are in the frame of the one that began first: where the two meet in the trajectories, they do in the truth.
    const SE3d T_first = here.motion().pose(0.0) * first.poses.front().inverse();
    const SE3d T_second = there.motion().pose(0.0) * second.poses.front().inverse();
    CHECK((T_first.translation() - T_second.translation()).norm() < 0.05);
    CHECK((T_first.rotation().inverse() * T_second.rotation()).log().norm() < 0.01);
    // Alone it has another world.
    CHECK(RecordedDrive(second, {}, small_options()).caster().world().boxes.size() != world.boxes.size());
  }

  TEST_CASE("fixes of a simulated receiver come in order, and are as far off as a receiver's are") {
    RecordedDriveOptions options = small_options();
    options.lidar.firings_per_revolution = 12;
    options.gnss.emplace().antenna_body.setZero();
    RecordedDrive drive(figure_of_eight(), {}, options);
    Timestamp last{};
    std::size_t fixes = 0;
    double worst = 0.0, best = 1e9;
    while (const auto packet = drive.next()) {
      if (const auto* fix = std::get_if<GnssFix>(&*packet)) {
        CHECK(fix->time >= last);
        last = fix->time;
        ++fixes;
        const SE3d truth = drive.motion().pose(to_seconds(fix->time - drive.epoch()));
        const double off = (fix->position_ecef - map_to_ecef(truth.translation())).norm();
        worst = std::max(worst, off);
        best = std::min(best, off);
      } else if (const auto* scan = std::get_if<LidarScan>(&*packet)) {
        CHECK(scan->end >= last);
        last = scan->end;
      }
    }
    CHECK(fixes > 60);  // two a second for 52 s, less the outages
    CHECK(fixes < 105);
    CHECK(worst < 40.0);
    CHECK(worst > 1.0);
    CHECK(best < 6.0);
  }

  TEST_CASE("rays meet what brute force meets, also where scans are taken") {
    const RecordedDrive drive(figure_of_eight(), {}, small_options());
    const test::BruteForce exact(drive.caster().world(), 0.0);
    Rng rng(5);
    int equal = 0;
    const int rays = chainslam::test::quick() ? 15 : 80;
    for (int i = 0; i < rays; ++i) {
      const SE3d T = drive.motion().pose(rng.uniform(0.0, drive.motion().duration()));
      const double azimuth = rng.uniform(0.0, 2.0 * std::numbers::pi), elevation = rng.uniform(-0.4, 0.1);
      const Eigen::Vector3d d(std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth),
                              std::sin(elevation));
      const Ray ray{(T.translation() + 0.8 * Eigen::Vector3d::UnitZ()).cast<float>(), d.cast<float>().normalized(),
                    90.0F};
      const auto hit = drive.caster().cast(ray);
      const double expected = exact.cast(ray);
      const double found = hit ? static_cast<double>(hit->distance) : std::numeric_limits<double>::infinity();
      equal += found == expected || std::abs(found - expected) < 2e-3 ? 1 : 0;
    }
    CHECK(equal >= rays - 1);  // a ray may graze an edge
  }

  TEST_CASE("each point of a sweep lies on the world from where the LiDAR was at the point's time") {
    RecordedDriveOptions options = small_options();
    LidarOptions& lidar = options.lidar;
    lidar.range_noise = lidar.lost_returns = lidar.elevation_error_deg = lidar.range_bias = 0.0;
    lidar.incidence_bias = lidar.mount_angle_deg = lidar.mount_shift = lidar.beam_width_deg = 0.0;
    const RecordedDrive drive(figure_of_eight(), {}, options);
    const LidarScan scan = drive.scan(130);
    REQUIRE(scan.cloud.size() > 2000);
    int near = 0, skewed = 0;
    for (std::size_t i = 0; i < scan.cloud.size(); ++i) {
      const double time = to_seconds(scan.time - drive.epoch()) + static_cast<double>(scan.cloud.time_offsets[i]);
      const Eigen::Vector3d p = scan.cloud.positions[i].cast<double>();
      const auto miss = [&](double at) {
        const SE3d T = drive.motion().pose(at) * lidar.T_body_lidar;
        const Eigen::Vector3d d = T.rotation() * p.normalized();
        const auto hit = drive.caster().cast({T.translation().cast<float>(), d.cast<float>().normalized(), 120.0F});
        return hit ? std::abs(static_cast<double>(hit->distance) - p.norm()) : 1e3;
      };
      near += miss(time) < 0.03 ? 1 : 0;  // a firing's lasers share one pose
      skewed += miss(time + 0.05) < 0.03 ? 1 : 0;
    }
    // Foliage gives back light from some way in.
    CHECK(near > 0.7 * static_cast<double>(scan.cloud.size()));
    CHECK(skewed < 0.6 * static_cast<double>(near));
  }

  TEST_CASE("the same seed gives the same scans, another one another world") {
    const RecordedDrive one(figure_of_eight(), {}, small_options()), same(figure_of_eight(), {}, small_options());
    RecordedDriveOptions options = small_options();
    options.seed = 2;
    const RecordedDrive other(figure_of_eight(), {}, options);
    CHECK(one.scan(7).cloud.positions == same.scan(7).cloud.positions);
    CHECK(one.scan(7).cloud.positions != other.scan(7).cloud.positions);
    CHECK(one.caster().world().boxes.size() != other.caster().world().boxes.size());
  }

  TEST_CASE("a LiDAR that is off its data sheet by the defaults measures what it says") {
    RecordedDriveOptions options = small_options();
    const RecordedDrive drive(figure_of_eight(), {}, options);
    const SE3d off = options.lidar.T_body_lidar.inverse() * drive.lidar().true_T_body_lidar();
    CHECK(off.rotation().log().norm() == doctest::Approx(0.2 * std::numbers::pi / 180.0));
    CHECK(off.translation().norm() == doctest::Approx(0.02));
    const LidarModel& model = drive.lidar().model();
    CHECK(model.name == "HDL-64E");
    CHECK(model.channels.size() == 64);
    const auto [low, high] = std::ranges::minmax(model.channels, {}, &LidarChannel::elevation_deg);
    CHECK(low.elevation_deg == doctest::Approx(-24.33));
    CHECK(high.elevation_deg == 2.0);
    CHECK(lidar_kind("hdl-64e") == LidarKind::hdl_64e);
    CHECK(lidar_kind("OS1-64") == LidarKind::os1_64);
    CHECK_FALSE(lidar_kind("HDL-65E"));
  }

  TEST_CASE("recorded samples come unchanged, in time order with the scans; without them they are simulated") {
    std::vector<ImuSample> imu;
    Rng rng(3);
    for (double t = 100.2; t < 151.0; t += 0.01)
      imu.push_back({.time = Timestamp(seconds(t)),
                     .gyro = {rng.normal(), rng.normal(), rng.normal()},
                     .accel = {0.0, 0.0, 9.81 + 0.1 * rng.normal()}});
    RecordedDrive drive(figure_of_eight(), imu, small_options());
    std::size_t samples = 0;
    Index scans = 0;
    Timestamp last = Timestamp();
    while (const auto packet = drive.next()) {
      const ImuSample* sample = std::get_if<ImuSample>(&*packet);
      const Timestamp time = sample != nullptr ? sample->time : std::get<LidarScan>(*packet).end;
      CHECK(time >= last);
      last = time;
      scans += sample == nullptr ? 1 : 0;
      if (sample == nullptr) continue;
      CHECK(sample->time == imu[samples].time);
      CHECK(sample->gyro == imu[samples].gyro);
      CHECK(sample->accel == imu[samples++].accel);
    }
    CHECK(samples == imu.size());
    CHECK(scans == 519);  // 52 s from pose to pose at 10 Hz, less what the sum of tenths loses
    const RecordedDrive simulated(figure_of_eight(), {}, small_options());
    const ImuAgreement fit = compare(simulated.motion(), simulated.imu(), simulated.epoch());
    CHECK(fit.gyro_rms < 0.02);  // biases of 0.003 and noise of 0.005 rad/s
    CHECK(fit.accel_rms < 0.15);
    CHECK(std::abs(fit.lag) < 1e-3);
  }

  TEST_CASE("a lag of the samples is found") {
    const RecordedDrive drive(figure_of_eight(), {}, small_options());
    for (const double lag : {-0.12, 0.0667, 0.2}) {
      std::vector<ImuSample> late = drive.imu();
      for (ImuSample& sample : late) sample.time = sample.time + seconds(lag);
      CHECK(compare(drive.motion(), late, drive.epoch()).lag == doctest::Approx(lag).epsilon(0.02));
    }
  }

  TEST_CASE("samples or axes that do not suit the trajectory are refused") {
    Trajectory lying = figure_of_eight();
    const SE3d over(SO3d::exp({0.5 * std::numbers::pi, 0.0, 0.0}), Eigen::Vector3d::Zero());
    for (SE3d& pose : lying.poses) pose = pose * over;
    CHECK_THROWS_AS(RecordedDrive(lying, {}, small_options()), std::invalid_argument);
    std::vector<ImuSample> in_g(100);
    for (std::size_t i = 0; i < in_g.size(); ++i)
      in_g[i] = {.time = Timestamp(seconds(101.0 + 0.1 * static_cast<double>(i))),
                 .gyro = Eigen::Vector3d::Zero(),
                 .accel = {0.0, 0.0, 1.0}};
    CHECK_THROWS_AS(RecordedDrive(figure_of_eight(), in_g, small_options()), std::invalid_argument);
  }

  TEST_CASE("what is written is what the reader of folders of clouds reads") {
    Trajectory part = figure_of_eight();
    part.times.resize(40);
    part.poses.resize(40);
    const RecordedDrive drive(part, {}, small_options());
    const TemporaryFolder folder;
    const ChunkRunner serial = [](Index count, Index, const std::function<void(Index, Index)>& body) {
      body(0, count);
    };
    const RecordedTexts texts{.source = "simulated scans, test", .options = "{}\n", .imu_rows = {}, .trajectory = part};
    const SimulationReport report = write_recorded_drive(drive, texts, folder / "drive", true, serial);
    CHECK(report.scans == drive.scan_count());
    const auto dataset = datasets::open_dataset(folder / "drive");
    CHECK(dataset->info().source == texts.source);
    CHECK_FALSE(dataset->info().motion_corrected);
    const auto truth = dataset->truth();
    REQUIRE(truth);
    CHECK(truth->times == drive.truth_at_scan_ends().times);
    Index scans = 0;
    std::size_t samples = 0;
    while (const auto packet = dataset->next()) {
      if (const auto* sample = std::get_if<ImuSample>(&*packet)) {
        CHECK((sample->gyro - drive.imu()[samples].gyro).norm() < 1e-8);
        CHECK((sample->accel - drive.imu()[samples].accel).norm() < 1e-6);
        CHECK(sample->time == drive.imu()[samples++].time);
        continue;
      }
      const LidarScan& read = std::get<LidarScan>(*packet);
      const LidarScan made = drive.scan(scans++);
      CHECK(std::abs(to_seconds(read.end - made.end)) < 2e-3);  // the last return, not the last firing
      CHECK(read.cloud.positions == made.cloud.positions);
      REQUIRE(read.cloud.has_times());
      double worst = 0.0;  // readers count a sweep's times from its first return
      for (std::size_t i = 0; i < made.cloud.size(); ++i)
        worst = std::max(worst, std::abs(to_seconds(read.time - made.time) +
                                         static_cast<double>(read.cloud.time_offsets[i] - made.cloud.time_offsets[i])));
      CHECK(worst < 1e-7);
    }
    CHECK(scans == drive.scan_count());
    CHECK(samples > 300);
  }
}

}  // namespace chainslam::simulator
