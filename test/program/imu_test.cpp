#include <doctest/doctest.h>

#include <algorithm>
#include <cstdio>
#include <fstream>
#include <numbers>
#include <optional>
#include <string>
#include <vector>

#include "chainslam/io/trajectory_file.hpp"
#include "program/run_program.hpp"
#include "support/drive_run.hpp"
#include "support/imu_faults.hpp"
#include "support/real_drives.hpp"

namespace {

using namespace chainslam;
using namespace chainslam::test;

constexpr double degree = std::numbers::pi / 180;

/// KITTI 00's 228 raw sweeps as a folder that the program reads, with other rows of the IMU and, if told, its mounting.
fs::path folder_of(const ScratchFolder& scratch, const std::string& name, const ImuSamples& imu,
                   const std::optional<SE3d>& T_body_lidar) {
  const auto data = real_data("kitti00_keyframes_imu/kitti00_keyframes_imu/kitti00_keyframes_imu/scans");
  REQUIRE(data);
  const fs::path folder = scratch.path() / name;
  fs::create_directories(folder);
  fs::create_directory_symlink(*data, folder / "scans");
  std::ofstream table(folder / "imu.csv");
  table << "timestamp,gx,gy,gz,ax,ay,az\n";
  for (const ImuSample& sample : imu) {
    char row[200];
    const Eigen::Vector3d &w = sample.gyro, &a = sample.accel;
    std::snprintf(row, sizeof row, "%.6f,%.8f,%.8f,%.8f,%.8f,%.8f,%.8f\n", sample.time.to_seconds(), w.x(), w.y(),
                  w.z(), a.x(), a.y(), a.z());
    table << row;
  }
  if (!T_body_lidar) return folder;
  std::ofstream extrinsic(folder / "T_body_lidar.txt");
  const Eigen::Vector3d& t = T_body_lidar->translation();
  const Eigen::Quaterniond q = T_body_lidar->rotation().quaternion();
  for (const double number : {t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w()}) {
    char text[32];
    std::snprintf(text, sizeof text, "%.9f ", number);
    extrinsic << text;
  }
  return folder;
}

/// What the program made of a folder.
struct Mapped {
  ProgramResult run;
  nlohmann::json summary;
  std::string report;
  double ape = 0;                ///< metres, of the LiDAR by odometry alone
  std::vector<Timestamp> times;  ///< of its frames

  [[nodiscard]] const nlohmann::json& imu() const { return summary["sessions"][0]["imu"]; }
};

/// @param T_body_lidar  that the odometry worked with.
Mapped map(const ScratchFolder& scratch, const Drive& drive, const fs::path& folder, const SE3d& T_body_lidar,
           const std::string& options = "") {
  const fs::path out = scratch.path() / "out";
  Mapped mapped;
  mapped.run = run_program(scratch.path(), "map " + quoted(folder) + " --overwrite --out " + quoted(out) + options);
  CAPTURE(mapped.run.errors);
  REQUIRE(mapped.run.exit_code == 0);
  mapped.summary = summary_of(out);
  mapped.report = read_text(out / "report.html");
  Trajectory lidar = read_tum(out / "odometry.tum");
  for (SE3d& pose : lidar.poses) pose = pose * T_body_lidar;
  mapped.times = lidar.times;
  mapped.ape = drive_ape(drive, lidar).translation.rmse;
  return mapped;
}

void figure(const std::string& name, double value, const char* unit) {
  std::printf("FIGURE %-60s %.4g %s\n", ("kitti00_keyframes_imu, " + name).c_str(), value, unit);
}

SO3d rotation_of(const nlohmann::json& rotation) {
  const auto q = rotation["quaternion_xyzw"].get<std::vector<double>>();
  return SO3d::from_quaternion(Eigen::Quaterniond(q[3], q[0], q[1], q[2]));
}

double degrees_between(const SO3d& a, const SO3d& b) { return a.local(b).norm() / degree; }

}  // namespace

TEST_SUITE("program/imu") {
  TEST_CASE("an IMU's clock that is 200 ms late is found, corrected and told, and the setting that is named mends it" *
            doctest::skip(quick())) {
    const auto drive = kitti00_keyframes(test::PointTimes::none);
    if (!drive) return;
    const ScratchFolder scratch("imu_clock");
    const SE3d& T = drive->T_body_lidar;
    const fs::path right = folder_of(scratch, "right", drive->imu, T);
    const fs::path late = folder_of(scratch, "late", stamped_late(drive->imu, 0.2), T);
    const Mapped good = map(scratch, *drive, right, T), mended = map(scratch, *drive, late, T);
    const double offset = good.imu()["time_offset"], found = mended.imu()["time_offset"];
    figure("as recorded: APE of odometry", good.ape, "m");
    figure("200 ms late: APE of odometry", mended.ape, "m");
    figure("200 ms late: error of the offset", 1e3 * (found - offset + 0.2), "ms");
    CHECK(std::abs(found - offset + 0.2) < 0.005);
    CHECK(std::abs(found + 0.2) < 3 * mended.imu()["time_offset_deviation"].get<double>() + 0.01);
    CHECK(mended.imu()["time_offset_known"] == true);
    CHECK(std::abs(mended.imu()["time_offset_applied"].get<double>() - found) < 0.005);
    CHECK_FALSE(mended.imu()["rotation_contradicted"].get<bool>());
    CHECK(mended.ape < 1.4 * good.ape);  // snapshots: what is left of the offset counts
    for (const std::string* text : {&mended.run.errors, &mended.report}) {
      CHECK(contains(*text, "ms late (+- "));
      CHECK(contains(*text, "set imu.time_offset = -0."));
    }
    CHECK(contains(mended.run.output, "imu.time_offset by the scans: -0."));
    CHECK_FALSE(contains(good.run.errors, "set imu.time_offset"));

    const Mapped set = map(scratch, *drive, late, T, " --set imu.time_offset=" + std::to_string(found));
    CHECK_FALSE(contains(set.run.errors, "set imu.time_offset"));
    CHECK(set.imu()["time_offset"].get<double>() == doctest::Approx(found).epsilon(0.03));

    // From the first one on, though the offset is found later.
    const Mapped on_imu = map(scratch, *drive, late, T, " --set odometry.clock=imu");
    REQUIRE(on_imu.times.size() == mended.times.size());
    for (std::size_t k = 0; k < on_imu.times.size(); ++k)
      CHECK(std::abs(to_seconds(on_imu.times[k] - mended.times[k]) + found) < 0.015);  // 3 deviations
    CHECK(contains(on_imu.run.errors, "poses have the times of the IMU's clock"));
    const fs::path recording = scratch.path() / "recording";
    const ProgramResult recorded = run_program(
        scratch.path(), "odometry " + quoted(late) + " --set odometry.clock=imu --out " + quoted(recording));
    CAPTURE(recorded.errors);
    REQUIRE(recorded.exit_code == 0);
    const Mapped again = map(scratch, *drive, recording, T, " --set odometry.clock=imu");
    CHECK(again.times == on_imu.times);

    const Mapped as_given = map(scratch, *drive, right, T, " --set imu.calibrate=false --max-scans 20");
    CHECK_FALSE(as_given.imu().contains("time_offset"));
    CHECK(contains(as_given.report, "as given"));
  }

  TEST_CASE("an IMU turned by 90 deg, not told: its axes are found, corrected and told, and inspect finds them, too" *
            doctest::skip(quick())) {
    const auto drive = kitti00_keyframes(test::PointTimes::none);
    if (!drive) return;
    const ScratchFolder scratch("imu_axes");
    const SO3d turn = SO3d::exp({0, 0, 90 * degree});
    const SO3d truth = turn * drive->T_body_lidar.rotation();
    const fs::path folder = folder_of(scratch, "turned", turned(drive->imu, turn), std::nullopt);
    const Mapped mapped = map(scratch, *drive, folder, SE3d());
    figure("turned by 90 deg, not told: APE of odometry", mapped.ape, "m");
    const double error = degrees_between(rotation_of(mapped.imu()["rotation"]), truth);
    figure("turned by 90 deg, not told: error of the rotation", error, "deg");
    CHECK(error < 0.5);
    CHECK(error < 4 * mapped.imu()["rotation"]["deviation_deg"].get<double>());
    CHECK(mapped.imu()["rotation_contradicted"] == true);
    CHECK(degrees_between(rotation_of(mapped.imu()["rotation_applied"]), truth) < 1);
    for (const std::string* text : {&mapped.run.errors, &mapped.report}) {
      CHECK(contains(*text, "axes are turned by"));
      CHECK(contains(*text, "set dataset.T_body_lidar = ["));
    }

    const std::string begin = "set dataset.T_body_lidar = ";
    const std::size_t at = mapped.run.errors.find(begin + '[');
    REQUIRE(at != std::string::npos);
    const std::size_t from = at + begin.size(), end = mapped.run.errors.find(']', from) + 1;
    const std::string setting = " --set dataset.T_body_lidar='" + mapped.run.errors.substr(from, end - from) + "'";
    const Mapped set = map(scratch, *drive, folder, SE3d(truth, Eigen::Vector3d::Zero()), setting);
    CHECK_FALSE(contains(set.run.errors, "set dataset.T_body_lidar = ["));

    const ProgramResult seen = run_program(scratch.path(), "inspect " + quoted(folder));
    CAPTURE(seen.output);
    CHECK(seen.exit_code == 0);
    CHECK(contains(seen.output, "imu.time_offset"));
    CHECK(contains(seen.output, "axes are turned by"));
    CHECK(contains(seen.output, "set dataset.T_body_lidar = ["));
    const ProgramResult skipped = run_program(scratch.path(), "inspect " + quoted(folder) + " --imu-seconds 0");
    CHECK(skipped.exit_code == 0);
    CHECK_FALSE(contains(skipped.output, "axes are turned by"));
  }
}
