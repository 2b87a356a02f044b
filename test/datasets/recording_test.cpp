#include <cmath>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "chainslam/io/pcd.hpp"
#include "datasets/odometry_recording.hpp"
#include "support/files.hpp"
#include "support/property.hpp"

#include <doctest/doctest.h>

namespace {

using namespace chainslam;
using namespace chainslam::datasets;
using namespace chainslam::test;

SE3d random_pose(Rng& rng) {
  const auto vector = [&](double scale) {
    return Eigen::Vector3d(scale * rng.normal(), scale * rng.normal(), scale * rng.normal());
  };
  const Eigen::Vector3d position = vector(std::pow(10.0, rng.uniform(-6, 6)));
  return SE3d(SO3d::exp(vector(1)), position);
}

FrameRecord random_frame(Rng& rng, std::int64_t time) {
  FrameRecord frame;
  frame.time = Timestamp::from_nanoseconds(time);
  frame.T_odom_body = random_pose(rng);
  Matrix6d covariance = Matrix6d::Zero();
  for (int i = 0; i < 6; ++i) covariance(i, i) = std::exp(rng.uniform(-30, 30));
  covariance(0, 4) = covariance(4, 0) = rng.normal() * 1e-9;
  if (rng.uniform() < 0.1) covariance(2, 2) = std::numeric_limits<double>::infinity();
  frame.covariance = PackedCovariance(covariance);
  frame.health = {.status = static_cast<FrameStatus>(rng.uniform_index(3)),
                  .points = rng.uniform_index(100'000),
                  .matches = rng.uniform_index(100'000),
                  .residual_rms = rng.uniform(),
                  .iterations = rng.uniform_index(30),
                  .map_restarted = rng.uniform() < 0.5,
                  .after_gap = rng.uniform() < 0.5};
  if (rng.uniform() < 0.8) frame.health.imu_use = static_cast<ImuUse>(rng.uniform_index(4));
  frame.health.imu_as_set = frame.health.imu_use == ImuUse::gyroscope && rng.uniform() < 0.5;
  if (rng.uniform() < 0.7)
    frame.delta_velocity = Eigen::Vector3d(rng.normal() * 1e-7, rng.normal(), rng.normal() * 1e3).cast<float>();
  return frame;
}

GnssFix random_fix(Rng& rng, std::int64_t time) {
  GnssFix fix;
  fix.time = Timestamp::from_nanoseconds(time);
  for (int i = 0; i < 3; ++i) fix.position_ecef[i] = 4e6 * rng.normal();
  for (int i = 0; i < 9; ++i) fix.covariance_ecef.data()[i] = rng.normal();
  fix.quality = static_cast<GnssQuality>(rng.uniform_index(6));
  return fix;
}

/// What is recorded, in its order: frames, some of them with a scan, and fixes.
struct Drive {
  std::vector<FrameRecord> frames;
  std::vector<PointCloud<float>> scans;  ///< of each frame; empty: no keyframe
  std::vector<GnssFix> fixes;
  std::vector<std::size_t> fixes_before;  ///< frames before each fix
};

Drive record(Rng& rng, int size, const std::filesystem::path& folder) {
  Drive drive;
  OdometryRecording recording(folder);
  std::int64_t time = 1'600'000'000'123'456'789;
  for (int i = 0; i < size; ++i) {
    for (; rng.uniform() < 0.3; time += 1) {
      drive.fixes.push_back(random_fix(rng, time));
      drive.fixes_before.push_back(drive.frames.size());
      recording.add(drive.fixes.back());
    }
    drive.frames.push_back(random_frame(rng, time += 1 + rng.uniform_index(1'000'000'000)));
    std::optional<Keyframe> keyframe;
    drive.scans.emplace_back();
    if (i == 0 || rng.uniform() < 0.5) {
      for (int k = 0; k < 3; ++k)
        drive.scans.back().positions.emplace_back(static_cast<float>(rng.normal()), 1e-20F, -3e7F);
      keyframe.emplace();
      keyframe->time = drive.frames.back().time;
      keyframe->T_odom_body = drive.frames.back().T_odom_body;
      keyframe->cloud = std::make_shared<const PointCloud<float>>(drive.scans.back());
    }
    recording.add(drive.frames.back(), keyframe);
  }
  drive.fixes.push_back(random_fix(rng, time));
  drive.fixes_before.push_back(drive.frames.size());
  recording.add(drive.fixes.back());
  Trajectory truth;
  truth.times = {drive.frames[0].time};
  truth.poses = {random_pose(rng)};
  recording.finish({.session = "drive \"1\"",
                    .odometry = "lidar",
                    .scans = size + 3,
                    .keyframes = {.distance = 1.5, .angle = 0.1, .scan_voxel = 0.3, .scan_step = 0.02},
                    .notes = {"a note"}},
                   truth);
  return drive;
}

bool same(const SE3d& a, const SE3d& b) {
  return a.translation() == b.translation() && a.rotation().quaternion().coeffs() == b.rotation().quaternion().coeffs();
}

std::string open_and_read(const std::filesystem::path& folder) {
  try {
    const auto dataset = open_dataset(folder);
    while (dataset->next_frame()) {
    }
  } catch (const IoError& error) {
    return error.what();
  }
  return "";
}

std::string replaced(std::string text, const std::string& what, const std::string& with) {
  const std::size_t at = text.find(what);
  REQUIRE(at != text.npos);
  return text.replace(at, what.size(), with);
}

}  // namespace

TEST_SUITE("datasets/recording") {
  TEST_CASE("recorded odometry reads back bit for bit, fixes in their places") {
    for_all(40, [](Rng& rng, int size) {
      const TemporaryFolder folder;
      const Drive drive = record(rng, size, folder.path());
      const auto dataset = open_dataset(folder.path());
      CHECK(dataset->info().kind == DatasetKind::keyframes);
      CHECK(dataset->info().name == "drive \"1\"");
      CHECK(dataset->info().keyframes ==
            KeyframeOptions{.distance = 1.5, .angle = 0.1, .scan_voxel = 0.3, .scan_step = 0.02});
      REQUIRE(dataset->truth());
      CHECK(dataset->truth()->times[0] == drive.frames[0].time);
      std::size_t fix = 0;
      const auto check_fixes = [&](std::size_t frames_before) {
        for (const GnssFix& read : dataset->take_fixes()) {
          REQUIRE(fix < drive.fixes.size());
          CHECK(drive.fixes_before[fix] == frames_before);
          CHECK(read.time == drive.fixes[fix].time);
          CHECK(read.position_ecef == drive.fixes[fix].position_ecef);
          CHECK(read.covariance_ecef == drive.fixes[fix].covariance_ecef);
          CHECK(read.quality == drive.fixes[fix].quality);
          ++fix;
        }
      };
      for (std::size_t i = 0; i < drive.frames.size(); ++i) {
        const auto frame = dataset->next_frame();
        REQUIRE(frame);
        check_fixes(i);
        const FrameRecord read = record_of(*frame), &wanted = drive.frames[i];
        CHECK(read.time == wanted.time);
        CHECK(same(read.T_odom_body, wanted.T_odom_body));
        CHECK(read.covariance == wanted.covariance);
        CHECK(read.health.status == wanted.health.status);
        CHECK(read.health.points == wanted.health.points);
        CHECK(read.health.matches == wanted.health.matches);
        CHECK(read.health.residual_rms == wanted.health.residual_rms);
        CHECK(read.health.iterations == wanted.health.iterations);
        CHECK(read.health.map_restarted == wanted.health.map_restarted);
        CHECK(read.health.after_gap == wanted.health.after_gap);
        CHECK(read.health.imu_use == wanted.health.imu_use);
        CHECK(read.health.imu_as_set == wanted.health.imu_as_set);
        CHECK(read.delta_velocity == wanted.delta_velocity);
        CHECK(frame->cloud.positions == drive.scans[i].positions);
      }
      CHECK(!dataset->next_frame());
      check_fixes(drive.frames.size());
      CHECK(fix == drive.fixes.size());
    });
  }

  TEST_CASE("a recording of an earlier version, without what the accelerometer measured, is read") {
    const TemporaryFolder folder;
    Rng rng(2);
    const Drive drive = record(rng, 12, folder.path());
    const std::string earlier = without_delta_velocity(read_bytes(folder / "frames.csv"));
    REQUIRE(earlier.substr(0, earlier.find('\n')).ends_with(",cov_rz_rz"));
    write_bytes(folder / "frames.csv", earlier);
    const auto dataset = open_dataset(folder.path());
    for (const FrameRecord& wanted : drive.frames) {
      const auto frame = dataset->next_frame();
      REQUIRE(frame);
      CHECK(frame->time == wanted.time);
      CHECK(record_of(*frame).covariance == wanted.covariance);
      CHECK(!frame->delta_velocity);
    }
    CHECK(!dataset->next_frame());
  }

  TEST_CASE("intensities of rounded scans are given to those who ask, and to no map") {
    for (const double step : {0.01, 0.0}) {
      const TemporaryFolder folder;
      PointCloud<float> scan;
      scan.positions = {{1, 2, 3}, {4, 5, 6}};
      scan.intensities = {7, 0.1F};
      Keyframe keyframe;
      keyframe.cloud = std::make_shared<const PointCloud<float>>(scan);
      OdometryRecording recording(folder.path());
      recording.add(FrameRecord{}, keyframe);
      recording.finish({.session = "drive", .odometry = "lidar", .scans = 1, .keyframes = {.scan_step = step}}, {});

      const PointCloud<float> file = read_pcd(folder / "Scans/000000.pcd");
      CHECK(file.positions == scan.positions);
      CHECK(file.intensities == scan.intensities);
      const auto read = [&](const DatasetOptions& options) {
        return open_dataset(folder.path(), options)->next_frame();
      };
      const std::optional<Frame> plain = read({}), asked = read({.recorded_intensities = true});
      REQUIRE((plain && asked));
      CHECK(plain->cloud.positions == scan.positions);
      CHECK(plain->cloud.intensities == (step > 0 ? std::vector<float>() : scan.intensities));  // else the map has them
      CHECK(asked->cloud.positions == scan.positions);
      CHECK(asked->cloud.intensities == scan.intensities);
    }
  }

  TEST_CASE("a damaged recording is refused with file, line and field") {
    const TemporaryFolder folder;
    Rng rng(1);
    record(rng, 9, folder.path());
    REQUIRE(open_and_read(folder.path()).empty());
    const auto with = [&](const char* file, const std::string& text) {
      const std::string whole = read_bytes(folder / file);
      write_bytes(folder / file, text);
      const std::string error = open_and_read(folder.path());
      write_bytes(folder / file, whole);
      CAPTURE(error);
      CHECK(says(error, file));
      CHECK(says(error, "do: "));
      return error;
    };
    const std::string frames = read_bytes(folder / "frames.csv"), json = read_bytes(folder / "odometry.json");
    const std::size_t second = frames.find('\n') + 1;
    CHECK(says(with("frames.csv", frames.substr(0, frames.rfind('\n', frames.size() - 2) + 1)), "8 frames"));
    CHECK(says(with("frames.csv", frames.substr(0, second + 40)), "line 2"));
    CHECK(says(with("frames.csv", frames.substr(second)), "other columns"));
    CHECK(says(with("frames.csv", ""), "an empty file"));
    const std::string earlier = without_delta_velocity(frames), rows = frames.substr(second);
    CHECK(says(with("frames.csv", frames.substr(0, second) + earlier.substr(earlier.find('\n') + 1)),
               "line 2, field delta velocity"));
    CHECK(says(with("frames.csv", earlier.substr(0, earlier.find('\n') + 1) + rows), "each line holds 38 fields"));
    CHECK(says(with("frames.csv", replaced(frames, ",0,", ",7,")), "field keyframe"));
    CHECK(says(with("fixes.csv", "frames_before\n"), "other columns"));
    CHECK(says(with("odometry.json", "{}"), "no description"));
    CHECK(says(with("odometry.json", "{"), "no description"));
    CHECK(says(with("odometry.json", replaced(json, "\"version\": 1", "\"version\": 2")), "version"));
    CHECK(says(with("odometry.json", replaced(json, "\"frames\": 9", "\"frames\": -9")), "frames"));
    CHECK(says(with("odometry.json", replaced(json, "\"session\"", "\"sesion\"")), "session"));
    std::filesystem::remove(folder / "Scans/000000.pcd");
    CHECK(!open_and_read(folder.path()).empty());
  }
}
