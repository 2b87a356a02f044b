#include <doctest/doctest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cstdint>
#include <numbers>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/odometry/lidar_inertial_odometry.hpp"
#include "chainslam/odometry/lidar_odometry.hpp"
#include "chainslam/odometry/self_calibrating.hpp"
#include "chainslam/sensor/imu_units.hpp"
#include "odometry/shared_drives.hpp"
#include "support/drive_run.hpp"
#include "support/imu_faults.hpp"
#include "support/quick.hpp"
#include "support/real_drives.hpp"

using namespace chainslam;

namespace {

using Calibrating = SelfCalibrating<LidarInertialOdometry<>>;
using Imu = std::vector<ImuSample>;

/// The error with the rows of an IMU in place of a drive's own. They come at their times; if the times are spoilt, at
/// those of the drive's own rows. No scan may be lost.
template <class Odometry>
double error_of(const test::Drive& drive, const Imu& imu, const typename Odometry::Options& settings = {},
                ImuCheckCounts* counts = nullptr) {
  typename Odometry::Options options = settings;
  options.T_body_lidar = drive.T_body_lidar;
  Odometry odometry(options);
  Trajectory lidar;
  const auto take = [&](const std::optional<Frame>& frame) {
    if (!frame) return;
    lidar.times.push_back(frame->time);
    lidar.poses.push_back(frame->T_odom_body * drive.T_body_lidar);
  };
  const Imu& timed = imu.size() == drive.imu.size() ? drive.imu : imu;
  std::size_t row = 0;
  for (const LidarScan& scan : drive.scans) {
    for (; row < imu.size() && timed[row].time <= scan.end; ++row) take(odometry.process(Packet(imu[row])));
    take(odometry.process(Packet(scan)));
  }
  if constexpr (requires { odometry.flush(); })
    while (const auto frame = odometry.flush()) take(frame);
  CHECK(odometry.counts().lost_scans == 0);
  CHECK(lidar.size() == drive.scans.size());
  if (counts != nullptr) *counts = odometry.counts().imu;
  const AbsolutePoseErrors errors = test::drive_ape(drive, lidar);
  REQUIRE(errors.status == EvaluationStatus::evaluated);
  return errors.translation.rmse;
}

/// The first `scans` of KITTI 00's, all of them with CHAINSLAM_FULL.
std::optional<test::Drive> clean_drive(std::size_t scans) {
  const auto& drive = test::first101();
  if (!drive) return std::nullopt;
  return test::beginning_of(*drive, test::full() ? drive->scans.size() : scans);
}

/// Of the rows: some dozen spikes.
double spike_share() { return test::full() ? 0.01 : 0.03; }

Imu doubled(const Imu& imu) {
  Imu result;
  for (const ImuSample& sample : imu) {
    result.push_back(sample);
    result.push_back(sample);
    result.back().time = sample.time + seconds(0.004);
  }
  return result;
}

/// With the rows of an IMU that lies on its side, half-way between.
Imu interleaved(const Imu& imu) {
  const Eigen::Matrix3d R = Eigen::AngleAxisd(std::numbers::pi / 2, Eigen::Vector3d::UnitX()).toRotationMatrix();
  Imu result;
  for (const ImuSample& sample : imu) {
    result.push_back(sample);
    result.push_back({sample.time + seconds(0.005), R * sample.gyro, R * sample.accel});
  }
  return result;
}

/// Single rows whose times are wrong by up to a minute, and rows that have changed places.
Imu disordered(Imu imu) {
  Rng rng(11);
  for (std::size_t i = 1; i < imu.size(); ++i) {
    if (rng.uniform() < 0.01) imu[i].time = imu[i].time + seconds(rng.uniform(-60, 60));
    if (rng.uniform() < 0.01) std::swap(imu[i - 1], imu[i]);
  }
  return imu;
}

/// Checks rows of bad measurements by the error that they cause, against that of good ones.
class Comparison {
 public:
  Comparison(std::string name, const test::Drive& clean) : name_(std::move(name)), clean_(clean) {
    good_ = error_of<Calibrating>(clean, clean.imu, {}, &counts_);
    CHECK(counts_.rejected() == 0);
    CHECK(counts_.received == rows());
  }

  void check(const std::string& what, double allowed, const Imu& imu, const Calibrating::Options& options = {}) {
    const double error = error_of<Calibrating>(clean_, imu, options, &counts_);
    MESSAGE(name_, ", ", what, ": ", error, " m (", good_, " m with good rows); rejected ", counts_.rejected(),
            ", stuck ", counts_.stuck_gyro, " and ", counts_.stuck_accel);
    CHECK(error <= allowed * good_);
  }

  [[nodiscard]] const ImuCheckCounts& counts() const { return counts_; }
  [[nodiscard]] std::int64_t rows() const { return static_cast<std::int64_t>(clean_.imu.size()); }

 private:
  std::string name_;
  const test::Drive& clean_;
  ImuCheckCounts counts_;
  double good_ = 0;
};

}  // namespace

TEST_SUITE("odometry with bad IMU data") {
  TEST_CASE("KITTI 00 with spoilt IMU rows is followed as with good ones" * doctest::skip(test::quick())) {
    const auto clean = clean_drive(60);
    if (!clean) return;
    Comparison compare("first " + std::to_string(clean->scans.size()) + " scans", *clean);
    for (const std::uint64_t seed : {1U, 2U, 3U}) {
      if (seed > 1 && !test::full()) break;
      const double spikes = spike_share() * static_cast<double>(compare.rows());
      compare.check("spikes", 1.1, test::with_spikes(clean->imu, spike_share(), Rng(seed)));
      CHECK(static_cast<double>(compare.counts().out_of_range) > 0.5 * spikes);
      CHECK(static_cast<double>(compare.counts().out_of_range) < 2 * spikes);
    }
    compare.check("times out of order", 1.1, disordered(clean->imu));
    compare.check("rows doubled", 1.001, doubled(clean->imu));
    CHECK(compare.counts().repeated >= compare.rows() - 1);
    compare.check("second IMU", 1.1, interleaved(clean->imu));
    CHECK(compare.counts().second_imu > compare.rows() - 30);
    for (int axis = 0; axis < 6; ++axis) {
      if (axis % 3 == 1 && !test::full()) continue;
      CAPTURE(axis);
      const auto sensor = axis < 3 ? &ImuSample::gyro : &ImuSample::accel;
      for (const double begin : {0.0, 2.0}) {
        if (begin == 2.0 * (axis % 2) && !test::full()) continue;
        compare.check("stuck axis", 1.3, test::with_stuck_axis(clean->imu, sensor, axis % 3, begin));
        CHECK((axis < 3 ? compare.counts().stuck_gyro : compare.counts().stuck_accel) > compare.rows() / 2);
      }
    }
  }

  TEST_CASE("the units of KITTI's IMU are told from its measurements, as readers do by a look at the file") {
    const auto& clean = test::first101();
    if (!clean) return;
    const ImuUnits units = infer_imu_units(test::in_g_and_degrees(clean->imu));
    CHECK(units.accel == AccelUnit::g);
    CHECK(units.gyro == GyroUnit::degrees_per_second);
  }

  TEST_CASE("the odometry itself tells deg/s within two seconds" * doctest::skip(test::quick())) {
    const auto clean = clean_drive(50);
    if (!clean) return;
    ImuCheckCounts counts;
    const double error = error_of<Calibrating>(*clean, test::in_g_and_degrees(clean->imu), {}, &counts);
    MESSAGE(error, " m");
    CHECK(counts.from_g == counts.received - 3);
    CHECK(counts.from_degrees >= counts.received - 200);
  }

  TEST_CASE("odometry of scans with a gyroscope, KITTI 00 with spoilt rows" * doctest::skip(test::quick())) {
    const auto clean = clean_drive(60);
    if (!clean) return;
    const double good = error_of<LidarOdometry<>>(*clean, clean->imu);
    const std::vector<std::pair<Imu, double>> spoilt{{test::with_spikes(clean->imu, spike_share(), Rng(1)), 1.1},
                                                     {doubled(clean->imu), 1.1},
                                                     {interleaved(clean->imu), 1.1},
                                                     {disordered(clean->imu), 1.1},
                                                     {test::with_stuck_axis(clean->imu, &ImuSample::gyro, 2, 2), 1.3}};
    for (const auto& [imu, allowed] : spoilt) {
      const double error = error_of<LidarOdometry<>>(*clean, imu);
      MESSAGE(error, " m, ", good, " m with good rows");
      CHECK(error <= allowed * good);
    }
  }

  TEST_CASE("a part of the IMU, or nothing of it, is used where the settings say so" * doctest::skip(test::quick())) {
    const auto clean = clean_drive(40);
    if (!clean) return;
    Imu wrong_force = clean->imu, wrong_rate = clean->imu;
    for (ImuSample& sample : wrong_force) sample.accel += Eigen::Vector3d(9, -3, 1);
    for (ImuSample& sample : wrong_rate) sample.gyro += Eigen::Vector3d(1, -3, 1);
    CHECK(error_of<Calibrating>(*clean, wrong_rate, {.imu_use = ImuUse::none}) == error_of<Calibrating>(*clean, {}));
    CHECK(error_of<Calibrating>(*clean, wrong_force, {.imu_use = ImuUse::gyroscope}) ==
          error_of<Calibrating>(*clean, clean->imu, {.imu_use = ImuUse::gyroscope}));
  }
}
