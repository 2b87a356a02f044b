#include "chainslam/odometry/lidar_odometry.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <optional>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/odometry/odometry_source.hpp"
#include "support/quick.hpp"
#include "support/threads_cases.hpp"
#include "support/world.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

using Pose = SE3d (*)(double);

SE3d pose_of(double x, double y, double z, double wx, double wy, double wz) {
  return SE3d(SO3d::exp({wx, wy, wz}), {x, y, z});
}
SE3d standing(double) { return {}; }
/// Walks a curve through the hall, turning and nodding: up to 1.6 m/s and 0.7 rad/s.
SE3d walking(double t) {
  return pose_of(1.5 * t - 0.1 * std::sin(3 * t), 1.2 * std::sin(0.5 * t), 0.1 * std::sin(2 * t),
                 0.03 * std::sin(2 * t), 0.04 * std::sin(3 * t), 0.6 * std::sin(1.1 * t));
}
SE3d ahead(double t) { return pose_of(2 * t, 0, 0, 0, 0, 0); }

struct Run {
  std::vector<Frame> frames;
  LidarOdometryCounts counts;
  SE3d T_world_odom;     ///< the truth at the first frame
  double max_error = 0;  ///< metres, of all poses after the first
  double max_angle = 0;  ///< radians
};

template <class Executor = Serial>
Run drive(const World& world, Pose pose, int scans, const Spinner& spinner, const LidarOdometryOptions<>& options = {},
          const Executor& executor = {}) {
  Run run;
  Rng rng(11);
  LidarOdometry<> odometry(options);
  for (int i = 0; i < scans; ++i) {
    auto frame = odometry.process(Packet(spinner.sweep(world, 0.1 * i, pose, rng)), executor);
    if (!frame) continue;
    const SE3d truth = pose(frame->time.to_seconds());
    if (run.frames.empty()) run.T_world_odom = truth * frame->T_odom_body.inverse();
    const Vector6d error = truth.local(run.T_world_odom * frame->T_odom_body);
    run.max_error = std::max(run.max_error, error.head<3>().norm());
    run.max_angle = std::max(run.max_angle, error.tail<3>().norm());
    run.frames.push_back(std::move(*frame));
  }
  run.counts = odometry.counts();
  return run;
}

LidarScan sweep_at(const World& world, double begin, Pose pose) {
  Rng rng(5);
  return Spinner{}.sweep(world, begin, pose, rng);
}

}  // namespace

TEST_SUITE("odometry/lidar_odometry") {
  TEST_CASE("a walk through a hall is followed, raw sweeps and no IMU") {
    const int scans = quick() ? 20 : 60;
    const Run run = drive(hall(), walking, scans, Spinner{});
    CHECK(std::ssize(run.frames) == scans);
    CHECK(run.frames.front().T_odom_body == SE3d());
    CHECK(run.counts.lost_scans == 0);
    CHECK(run.counts.degenerate_scans == 0);
    MESSAGE("a walk of ", scans, " scans: max error ", run.max_error, " m, ", run.max_angle, " rad");
    CHECK(run.max_error < 0.03);
    CHECK(run.max_angle < 0.006);
  }

  TEST_CASE("correcting the sweeps is what keeps the walk straight" * doctest::skip(quick())) {
    const auto crosswise = [](const Run& run) {
      double sum = 0;
      for (const Frame& frame : run.frames) sum += frame.health.residual_rms;
      return sum / static_cast<double>(run.frames.size() - 1);
    };
    LidarScan scan = sweep_at(hall(), 0, walking);
    Rng rng(11);
    LidarOdometry<> raw;
    double raw_rms = 0;
    for (int i = 0; i < 40; ++i) {
      scan = Spinner{}.sweep(hall(), 0.1 * i, walking, rng);
      scan.cloud.time_offsets.clear();
      scan.time = scan.end;
      raw_rms += raw.process(Packet(scan))->health.residual_rms / 39;
    }
    CHECK(crosswise(drive(hall(), walking, 40, Spinner{})) < 0.9 * raw_rms);
  }

  TEST_CASE("standing still does not tilt") {
    const Run run = drive(hall(), standing, quick() ? 15 : 60, Spinner{});
    CHECK(run.max_error < 0.003);
    CHECK(run.max_angle < 3e-4);
  }

  TEST_CASE("a start at full speed is caught, from the second scan on") {
    const Run run = drive(
        hall(), [](double t) { return pose_of(-8 + 8 * t, 0, 0, 0, 0, 0); }, 15, Spinner{});
    CHECK(run.counts.lost_scans == 0);
    CHECK(run.max_error < 0.06);
  }

  TEST_CASE("a snapshot keeps its own time, and the mounting is taken off") {
    LidarOdometryOptions<> options;
    options.T_body_lidar = pose_of(0.4, -0.3, 1.0, 0.02, 0.1, 1.2);
    Spinner spinner{.timed = false};
    Rng rng(12);
    LidarOdometry<> odometry(options);
    double worst = 0;
    for (int i = 0; i < 30; ++i) {
      const auto lidar = [&](double t) { return walking(t) * options.T_body_lidar; };
      const LidarScan scan = spinner.sweep(hall(), 0.1 * i, lidar, rng);
      const auto frame = odometry.process(Packet(scan));
      REQUIRE(frame.has_value());
      CHECK(frame->time == scan.time);
      const SE3d truth = walking(0.1).inverse() * walking(frame->time.to_seconds());
      worst = std::max(worst, (truth.inverse() * frame->T_odom_body).translation().norm());
    }
    CHECK(worst < 0.05);
  }

  TEST_CASE("a corridor without ends: its direction is reported and left to the prediction") {
    const Run run = drive(corridor(), ahead, 20, Spinner{.noise = 0.02});
    for (std::size_t i = 1; i < run.frames.size(); ++i) {
      CHECK(run.frames[i].health.status == FrameStatus::degenerate);
      const Matrix6d& covariance = run.frames[i].covariance;
      CHECK(covariance(0, 0) > 100 * covariance(1, 1));  // along against across
      CHECK(std::abs(run.frames[i].T_odom_body.translation().y()) < 0.02);
    }
    CHECK(run.counts.degenerate_scans == 19);
  }

  TEST_CASE("broken points are dropped and counted, and change nothing else") {
    const float nan = std::numeric_limits<float>::quiet_NaN();
    LidarOdometry<> clean, dirty;
    Rng rng(13);
    for (int i = 0; i < 10; ++i) {
      LidarScan scan = Spinner{}.sweep(hall(), 0.1 * i, walking, rng);
      const auto expected = clean.process(Packet(scan));
      for (const Eigen::Vector3f& bad : {Eigen::Vector3f(nan, 1, 1), Eigen::Vector3f(0, 0, 0),
                                         Eigen::Vector3f(0.2F, 0, 0), Eigen::Vector3f(500, 0, 0)}) {
        scan.cloud.positions.push_back(bad);
        scan.cloud.time_offsets.push_back(0.05F);
      }
      CHECK(dirty.process(Packet(scan))->T_odom_body == expected->T_odom_body);
    }
    CHECK(dirty.counts().points.not_finite == 10);
    CHECK(dirty.counts().points.zero == 10);
    CHECK(dirty.counts().points.near == 10);
    CHECK(dirty.counts().points.far == 10);
  }

  TEST_CASE("empty scans, scans of nothing but NaN and scans out of order give no frame and are counted") {
    LidarOdometry<> odometry;
    LidarScan empty;
    CHECK_FALSE(odometry.process(Packet(empty)).has_value());  // before the first
    CHECK(odometry.process(Packet(sweep_at(hall(), 1, walking))).has_value());
    empty.time = empty.end = Timestamp::from_seconds(1.2);
    CHECK_FALSE(odometry.process(Packet(empty)).has_value());
    LidarScan broken = sweep_at(hall(), 1.1, walking);
    for (auto& p : broken.cloud.positions) p.setConstant(std::numeric_limits<float>::quiet_NaN());
    CHECK_FALSE(odometry.process(Packet(broken)).has_value());
    CHECK_FALSE(odometry.process(Packet(sweep_at(hall(), 0.8, walking))).has_value());
    LidarScan reversed = sweep_at(hall(), 1.2, walking);
    std::swap(reversed.time, reversed.end);
    CHECK_FALSE(odometry.process(Packet(reversed)).has_value());
    LidarScan stretched = sweep_at(hall(), 1.0, walking);  // ends later, but most of it lies before the last frame
    stretched.end = stretched.end + seconds(0.01);
    stretched.time = stretched.time - seconds(0.05);
    CHECK_FALSE(odometry.process(Packet(stretched)).has_value());
    CHECK(odometry.process(Packet(sweep_at(hall(), 1.3, walking)))->health.status == FrameStatus::good);
    CHECK(odometry.counts().empty_scans == 3);
    CHECK(odometry.counts().out_of_order_scans == 3);
    CHECK(odometry.counts().frames == 2);
  }

  TEST_CASE("a jump in time is counted and survived") {
    LidarOdometry<> odometry;
    const auto slow = [](double t) { return pose_of(0.1 * t, 0, 0, 0, 0, 0); };
    for (int i = 0; i < 5; ++i) odometry.process(Packet(sweep_at(hall(), 0.1 * i, slow)));
    const auto frame = odometry.process(Packet(sweep_at(hall(), 8, slow)));
    REQUIRE(frame.has_value());
    CHECK(odometry.counts().gaps == 1);
    CHECK(frame->health.after_gap);
    CHECK_FALSE(frame->health.imu_use.has_value());
    CHECK(frame->health.status == FrameStatus::good);
    CHECK((frame->T_odom_body.translation() - Eigen::Vector3d(0.8, 0, 0)).norm() < 0.05);
  }

  TEST_CASE("scans of another place are lost: predicted pose, growing covariance, then a new map") {
    LidarOdometryOptions<> options;
    options.max_lost_scans = 3;
    LidarOdometry<> odometry(options);
    for (int i = 0; i < 10; ++i) odometry.process(Packet(sweep_at(hall(), 0.1 * i, ahead)));
    const std::size_t points = odometry.local_map().size();
    World elsewhere;
    elsewhere.add_box({3, 1, 4}, {10, 10, 9});  // its walls, floor and ceiling stand elsewhere than the hall's
    double last_variance = 0;
    for (int i = 10; i < 13; ++i) {
      const auto frame = odometry.process(Packet(sweep_at(elsewhere, 0.1 * i, ahead)));
      REQUIRE(frame.has_value());
      CHECK_MESSAGE(frame->health.status == FrameStatus::lost, frame->health.matches, " of ", frame->health.points);
      CHECK(frame->covariance(0, 0) > last_variance);
      CHECK(frame->T_odom_body.translation().x() == doctest::Approx(0.2 * i).epsilon(0.05));
      CHECK(odometry.local_map().size() == points);
      last_variance = frame->covariance(0, 0);
    }
    const auto restart = odometry.process(Packet(sweep_at(elsewhere, 1.3, ahead)));
    CHECK(restart->health.status == FrameStatus::lost);
    CHECK(restart->health.map_restarted);
    CHECK(restart->covariance(0, 0) >= 4);  // 5 m/s for 0.4 s
    CHECK(odometry.counts().map_restarts == 1);
    const auto after = odometry.process(Packet(sweep_at(elsewhere, 1.4, ahead)));
    CHECK(after->health.status != FrameStatus::lost);
    CHECK_FALSE(after->health.map_restarted);
    CHECK(after->covariance(0, 0) >= restart->covariance(0, 0));  // it fits the new map, whose place is a guess
    CHECK(after->covariance(0, 0) < restart->covariance(0, 0) + 0.1);
  }

  THREADS_TEST_CASE("odometry/lidar_odometry", "threads change no bit") {
    const ThreadPool threads(3);
    const Run serial = drive(hall(), walking, 12, Spinner{});
    const Run parallel = drive(hall(), walking, 12, Spinner{}, {}, threads);
    REQUIRE(serial.frames.size() == parallel.frames.size());
    for (std::size_t i = 0; i < serial.frames.size(); ++i) {
      CHECK(serial.frames[i].T_odom_body == parallel.frames[i].T_odom_body);
      CHECK(serial.frames[i].covariance == parallel.frames[i].covariance);
      CHECK(serial.frames[i].cloud.positions == parallel.frames[i].cloud.positions);
    }
  }

  TEST_CASE("with a gyroscope quick turns are followed, and +z of odom is up") {
    // Turning to and fro by 1.2 rad within half a second: 3.8 rad/s at most, 24 rad/s^2.
    const auto whirl = [](double t) {
      return t < 0.5 ? SE3d() : pose_of(0, 0, 0, 0, 0, 0.6 * (1 - std::cos(2 * std::numbers::pi * (t - 0.5))));
    };
    const SO3d tilt = SO3d::exp({0.2, -0.1, 0});  // of the body in the world
    const auto body = [&](double t) { return whirl(t) * SE3d(tilt, Eigen::Vector3d::Zero()); };
    LidarOdometry<> odometry;
    Rng rng(14);
    double worst = 0;
    std::optional<SE3d> T_world_odom;
    const int scans = quick() ? 16 : 40;
    const auto noise = [&](double size) {  // without any, the axes would count as stuck
      return Eigen::Vector3d(size * rng.normal(), size * rng.normal(), size * rng.normal());
    };
    for (int i = 0; i < scans; ++i) {
      for (int k = 0; k < 20; ++k) {
        const double t = 0.1 * i + 0.005 * k;
        const Eigen::Vector3d rate = (body(t - 1e-4).rotation().inverse() * body(t + 1e-4).rotation()).log() / 2e-4;
        odometry.process(Packet(ImuSample{.time = Timestamp::from_seconds(t),
                                          .gyro = rate + noise(1e-4) + Eigen::Vector3d(0.004, -0.003, 0.002),
                                          .accel = tilt.inverse() * Eigen::Vector3d(0, 0, 9.81) + noise(1e-3)}));
      }
      const auto frame = odometry.process(Packet(Spinner{}.sweep(hall(), 0.1 * i, body, rng)));
      REQUIRE(frame.has_value());
      CHECK(frame->health.status == FrameStatus::good);
      const SE3d truth = body(frame->time.to_seconds());
      if (!T_world_odom) T_world_odom = truth * frame->T_odom_body.inverse();
      const Vector6d error = truth.local(*T_world_odom * frame->T_odom_body);
      worst = std::max(worst, error.head<3>().norm() + error.tail<3>().norm());
    }
    CHECK(odometry.imu_start().at_rest);
    CHECK(odometry.counts().gyro_scans == scans - 1);
    CHECK((T_world_odom->rotation() * Eigen::Vector3d::UnitZ() - Eigen::Vector3d::UnitZ()).norm() < 1e-3);
    CHECK(worst < 0.03);
  }

  TEST_CASE("the covariance is about as large as the errors are" * doctest::skip(quick())) {
    // Normalized squared errors of the poses of a walk, over the six dimensions: one would be perfect.
    LidarOdometryOptions<> options;
    LidarOdometry<> odometry(options);
    Rng rng(15);
    double nees = 0;
    int n = 0;
    SE3d first;
    for (int i = 0; i < 60; ++i) {
      const auto frame = odometry.process(Packet(Spinner{.noise = 0.02}.sweep(hall(), 0.1 * i, walking, rng)));
      const SE3d truth = walking(frame->time.to_seconds());
      if (i == 0) first = truth;
      if (i < 5) continue;
      const Vector6d error = (first.inverse() * truth).local(frame->T_odom_body);
      nees += error.dot(frame->covariance.inverse() * error) / 6;
      ++n;
    }
    MESSAGE("NEES / 6: ", nees / n);
    CHECK(nees / n > 0.05);
    CHECK(nees / n < 10);
  }
}

TEST_SUITE("odometry/recorded_odometry") {
  TEST_CASE("frames are passed on; those without a pose on Earth or out of order are dropped and counted") {
    std::vector<double> times{1, 2, 2, 3, 2.5, 4, 5, 6};
    std::size_t at = 0;
    const auto next = [&]() -> std::optional<Frame> {
      if (at == times.size()) return std::nullopt;
      Frame frame;
      frame.time = Timestamp::from_seconds(times[at]);
      if (at == 3) frame.T_odom_body = SE3d(SO3d(), {std::numeric_limits<double>::quiet_NaN(), 0, 0});
      if (at == 6) frame.T_odom_body = SE3d(SO3d(), {0, -1e150, 0});
      if (at == 7) frame.T_odom_body = SE3d(SO3d(), {1e8, -1e8, 1e8});
      ++at;
      return frame;
    };
    RecordedOdometry odometry(next);
    static_assert(OdometrySource<decltype(odometry)>);
    std::vector<double> seen;
    while (const auto frame = odometry.next()) seen.push_back(frame->time.to_seconds());
    CHECK(seen == std::vector<double>{1, 2, 2.5, 4, 6});
    CHECK(odometry.not_finite() == 1);
    CHECK(odometry.too_far() == 1);
    CHECK(odometry.out_of_order() == 1);
    CHECK_FALSE(odometry.next().has_value());
  }
}
