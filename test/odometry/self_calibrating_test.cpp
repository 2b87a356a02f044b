#include "chainslam/odometry/self_calibrating.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "chainslam/odometry/lidar_inertial_odometry.hpp"
#include "odometry/inertial_trip.hpp"
#include "support/quick.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

using Lio = LidarInertialOdometry<>;

// What scans alone, as coarse as here, leave of this motion; until the IMU is believed, there is nothing else.
constexpr double error_of_scans = 0.12;  // metres

/// About all axes, around a place in the hall; at rest at the start.
SE3d swaying(double t) {
  const double grown = t <= 0 ? 0 : std::min(1.0, 0.5 * t * t);
  const auto wave = [&](double rate) { return grown * std::sin(rate * t); };
  return SE3d(SO3d::exp({0.3 * wave(1.9), 0.25 * wave(2.3), 0.6 * wave(1.1)}),
              {0.6 * wave(1.3), 0.5 * wave(1.7), 0.2 * wave(2.1)});
}

/// The trip's packets with an IMU of another clock and other axes.
std::vector<Packet> packets_of(const InertialTrip& trip, double late, const SO3d& R_imu_body) {
  std::vector<Packet> packets = trip.packets();
  for (Packet& packet : packets)
    if (auto* sample = std::get_if<ImuSample>(&packet)) {
      sample->time = sample->time + seconds(late);
      sample->gyro = R_imu_body * sample->gyro;
      sample->accel = R_imu_body * sample->accel;
    }
  std::ranges::stable_sort(packets, {}, available_at);
  return packets;
}

struct Calibrated : TripOutcome {
  ImuCorrection correction;
  ImuAlignmentEstimate estimate;
  Index doubted = 0;              ///< scans that did not believe all of the IMU
  bool believed = true;           ///< the last scan did
  double axes_left = 0;           ///< rad, of the rotation that is told
  double mounting_deviation = 0;  ///< rad, about each axis, rms: what the filter says of the given mounting
};
Calibrated follow(const InertialTrip& trip, double late, const SO3d& R_imu_body = {}) {
  SelfCalibrating<Lio> odometry(Lio::Options{.T_body_lidar = trip.T_body_lidar});
  Calibrated run;
  static_cast<TripOutcome&>(run) = follow_trip(trip, packets_of(trip, late, R_imu_body), odometry);
  run.correction = odometry.odometry().imu_correction();
  run.estimate = odometry.alignment();
  run.axes_left = (R_imu_body * trip.T_body_lidar.rotation()).local(run.estimate.R_body_lidar).norm();
  run.doubted = static_cast<Index>(odometry.counts().rejected_accelerations + odometry.counts().rejected_rates);
  run.believed = run.frames.back().health.imu_use == ImuUse::all;
  run.mounting_deviation = std::sqrt(odometry.odometry().covariance().bottomRightCorner<3, 3>().trace() / 3);
  CHECK(odometry.counts().lost_scans == 0);
  CHECK(run.finite);
  MESSAGE(late, " s late, turned by ", R_imu_body.log().norm(), " rad, ", run.axes_left, " of it left: max error ",
          run.max_error, " m, ", run.max_angle, " rad, offset ", run.estimate.time_offset, " +- ",
          run.estimate.time_offset_deviation, " s, corrected by ", run.correction.time_offset, " s and ",
          run.correction.R_body_imu.log().norm(), " rad, doubted in ", run.doubted, " scans");
  return run;
}

InertialTrip swaying_trip(int scans) {
  return {.pose = swaying,
          .T_body_lidar = SE3d(SO3d::exp({0.02, 0.01, 0.5}), {0.1, -0.05, 0.2}),
          .scans = scans,
          .spinner = {.rings = 32, .columns = 120}};
}

}  // namespace

TEST_SUITE("odometry/self_calibrating") {
  TEST_CASE("a right clock and right axes are left alone") {
    const Calibrated run = follow(swaying_trip(80), 0);
    CHECK(std::abs(run.correction.time_offset) == 0);
    CHECK(run.correction.R_body_imu.log().norm() == 0);
    CHECK_FALSE(run.estimate.contradicted);
    CHECK(run.max_error < 0.07);
    CHECK(run.believed);
  }

  TEST_CASE("an IMU whose stamps are late or early is corrected, and believed from then on" * doctest::skip(quick())) {
    for (const double late : {0.2, -0.1, 0.07}) {
      if (late == 0.07 && !full()) break;
      const Calibrated run = follow(swaying_trip(100), late);
      CHECK(std::abs(run.correction.time_offset - late) < 0.012);
      CHECK(run.correction.R_body_imu.log().norm() == 0);
      CHECK(run.mounting_deviation > 1e-5);  // it is estimated, as before the correction
      CHECK(run.max_error < error_of_scans);
      CHECK(run.believed);
    }
  }

  TEST_CASE("axes that are not those given are found, and measurements turned into them" * doctest::skip(quick())) {
    for (const Eigen::Vector3d& axis : {Eigen::Vector3d(1, 0, 0), Eigen::Vector3d(0, 1, 0), Eigen::Vector3d(0, 0, 1)})
      for (const double angle : {std::numbers::pi / 2, std::numbers::pi}) {
        if (!full() && (angle > 2) != (axis.z() > 0)) continue;  // upside down is a test of its own
        const SO3d R_imu_body = SO3d::exp(angle * axis);
        const Calibrated run = follow(swaying_trip(100), 0, R_imu_body);
        CHECK(run.estimate.contradicted);
        CHECK((run.correction.R_body_imu * R_imu_body).log().norm() < 0.0087);  // half a degree
        CHECK(run.axes_left < 0.0087);
        CHECK(run.max_error < error_of_scans);
        CHECK(run.believed);
      }
  }

  TEST_CASE("a late clock and turned axes at once" * doctest::skip(quick())) {
    const SO3d R_imu_body = SO3d::exp({0.3, -1.2, 2});
    const Calibrated run = follow(swaying_trip(100), 0.12, R_imu_body);
    CHECK(std::abs(run.correction.time_offset - 0.12) < 0.012);
    CHECK((run.correction.R_body_imu * R_imu_body).log().norm() < 0.0087);
    CHECK(run.axes_left < 0.0087);
    CHECK(run.max_error < error_of_scans);
    CHECK(run.believed);
  }
}
