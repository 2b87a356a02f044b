#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>
#include <optional>
#include <string>
#include <vector>

#include "chainslam/io/map_archive.hpp"
#include "datasets/odometry_recording.hpp"
#include "program/keyframe_data.hpp"
#include "program/run_program.hpp"
#include "support/files.hpp"

// Settings of the back end, by what they do to a map.

namespace {

using namespace chainslam;
using namespace chainslam::test;

constexpr int keyframes_of_a_drive = 36;

/// Poses of the keyframes of a data set, mapped with some settings.
std::vector<SE3d> poses_of_map(const ScratchFolder& scratch, const fs::path& data, const std::string& settings) {
  const fs::path out = scratch.path() / "out";
  fs::remove_all(out);
  std::string options;
  for (std::size_t at = 0; at < settings.size();) {
    const std::size_t end = std::min(settings.find(' ', at), settings.size());
    options += " --set " + settings.substr(at, end - at);
    at = end + 1;
  }
  const ProgramResult result = run_program(scratch.path(), "map " + quoted(data) + " --out " + quoted(out) + options);
  CAPTURE(result.errors);
  REQUIRE(result.exit_code == 0);
  const LoadedMap loaded = load_map(out / "map.cslam");
  std::vector<SE3d> poses;
  for (const Keyframe& keyframe : loaded.map.keyframes) poses.push_back(keyframe.T_map_body);
  REQUIRE(poses.size() == keyframes_of_a_drive);
  return poses;
}

/// All chunks of a map's file as they are stored, but for the settings and what is of the file itself.
std::string stored_records(const fs::path& path) {
  const chainslam::detail::MapFileReader file(path);
  std::string records;
  for (std::size_t i = 0; i < file.chunks().size(); ++i) {
    const auto& header = file.chunks()[i].header;
    using Type = chainslam::detail::ChunkType;
    if (header.is(Type::parameters) || header.is(Type::index) || header.is(Type::end)) continue;
    const std::vector<std::byte> payload = file.stored_payload(i).value();
    records += std::to_string(header.type) + ' ' + std::to_string(header.count) + ' ';
    records.append(reinterpret_cast<const char*>(payload.data()), payload.size());
  }
  return records;
}

/// One and a third rounds of a circle of 20 m with a fix at each keyframe, mapped with some settings.
class RoundMap {
 public:
  RoundMap() : scratch_("back_end_settings") { write_keyframes(data(), keyframes_of_a_drive, true); }

  [[nodiscard]] std::vector<SE3d> poses(const std::string& settings) const {
    return poses_of_map(scratch_, data(), settings);
  }
  /// All that the map's file has with these settings.
  [[nodiscard]] std::string records(const std::string& settings) const {
    static_cast<void>(poses(settings));
    return stored_records(scratch_.path() / "out/map.cslam");
  }

 private:
  [[nodiscard]] fs::path data() const { return scratch_.path() / "data"; }

  ScratchFolder scratch_;
};

/// The same circle, level, driven in 52.5 s and recorded by odometry whose frame leans by 2 degrees and whose roll and
/// pitch drift, with what an accelerometer measured between its frames. From 21 to 31.5 s, that is off by 20 degrees.
class LeaningMap {
 public:
  LeaningMap() : scratch_("back_end_gravity") {
    fs::create_directories(data());
    record();
    fs::copy(data(), earlier(), fs::copy_options::recursive);
    write_text(earlier() / "frames.csv", without_delta_velocity(read_text(data() / "frames.csv")));
  }

  [[nodiscard]] std::vector<SE3d> poses(const std::string& settings) const {
    return poses_of_map(scratch_, data(), short_drive + settings);
  }
  /// Of the recording as earlier versions wrote it, without the accelerometer.
  [[nodiscard]] std::vector<SE3d> poses_of_earlier(const std::string& settings) const {
    return poses_of_map(scratch_, earlier(), short_drive + settings);
  }

 private:
  static constexpr int frames_of_a_keyframe = 6;
  static constexpr double interval = 1.5 / frames_of_a_keyframe;  // seconds between frames
  static constexpr double wrong = 20;                             // degrees
  static constexpr double turn_rate = 2 * std::numbers::pi / 40, radius = 20;

  [[nodiscard]] fs::path data() const { return scratch_.path() / "data"; }
  [[nodiscard]] fs::path earlier() const { return scratch_.path() / "earlier"; }

  static SE3d truth(double time) {
    const double angle = turn_rate * time;
    return SE3d(SO3d::exp({0, 0, angle + std::numbers::pi / 2}),
                {radius * std::cos(angle), radius * std::sin(angle), 0});
  }

  static Eigen::Vector3d velocity(double time) {
    const double angle = turn_rate * time;
    return radius * turn_rate * Eigen::Vector3d(-std::sin(angle), std::cos(angle), 0);
  }

  static Eigen::Vector3f delta_velocity(double time) {
    constexpr double gravity = 9.80665;
    const Eigen::Vector3d gained =
        velocity(time) - velocity(time - interval) + Eigen::Vector3d(0, 0, gravity * interval);
    Eigen::Vector3d in_body = truth(time).rotation().inverse() * gained;
    if (time > 21 && time <= 31.5) in_body = SO3d::exp({wrong * std::numbers::pi / 180, 0, 0}) * in_body;
    return in_body.cast<float>();
  }

  void record() const {
    datasets::OdometryRecording recording(data());
    Rng walls(1), drift(5);
    const std::vector<Eigen::Vector3f> place = walled_place(walls, 250);
    SE3d T_odom_body(SO3d::exp({0.03, -0.02, 0}), {0, 0, 0});
    const int frames = (keyframes_of_a_drive - 1) * frames_of_a_keyframe + 1;
    for (int i = 0; i < frames; ++i) {
      const double time = interval * i;
      FrameRecord frame{.time = Timestamp(seconds(100 + time))};
      if (i > 0) {
        const SE3d step = truth(time - interval).inverse() * truth(time);
        const SE3d error(SO3d::exp({drift.normal(0, 0.001), drift.normal(0, 0.001), drift.normal(0, 0.001)}),
                         {drift.normal(0, 0.005), 0, 0});
        T_odom_body = T_odom_body * step * error;
        frame.delta_velocity = delta_velocity(time);
      }
      frame.T_odom_body = T_odom_body;
      frame.health = {.points = 1000, .matches = 900, .imu_use = ImuUse::all};
      std::optional<Keyframe> keyframe;
      if (i % frames_of_a_keyframe == 0) {
        PointCloud<float> near;
        for (const Eigen::Vector3f& p : transformed(place, truth(time).inverse()).positions)
          if (p.norm() < 18) near.positions.push_back(p);
        keyframe.emplace();
        keyframe->time = frame.time;
        keyframe->T_odom_body = frame.T_odom_body;
        keyframe->cloud = std::make_shared<const PointCloud<float>>(std::move(near));
      }
      recording.add(frame, keyframe);
    }
    recording.finish({.session = "leaning", .odometry = "lidar_inertial", .scans = frames}, {});
  }

  /// Its loop is shorter than what keeps a scan out of its own submap.
  static constexpr const char* short_drive = "closures.min_keyframes=0 ";

  ScratchFolder scratch_;
};

/// How much keyframes differ in height, metres.
double height_range(const std::vector<SE3d>& poses) {
  double least = poses[0].translation().z(), most = least;
  for (const SE3d& pose : poses) {
    least = std::min(least, pose.translation().z());
    most = std::max(most, pose.translation().z());
  }
  return most - least;
}

/// The largest distance of two maps' keyframes, metres.
double apart(const std::vector<SE3d>& a, const std::vector<SE3d>& b) {
  double most = 0;
  for (std::size_t i = 0; i < a.size(); ++i) most = std::max(most, (a[i].translation() - b[i].translation()).norm());
  return most;
}

}  // namespace

TEST_SUITE("program/back_end_settings") {
  TEST_CASE(
      "fixes hold a map where they spread far enough, and are many and good enough; the antenna may stand aside") {
    const RoundMap map;
    const std::string held = "graph.gnss_min_spread=10 graph.gnss_bias=0.1 graph.gnss_correlation_time=0";
    const std::vector<SE3d> without = map.poses("graph.gnss=false"), with = map.poses(held);
    CHECK(apart(map.poses(""), without) == 0);  // 14 m across are too few to say where the map lies
    CHECK(apart(with, without) > 0.01);
    CHECK(apart(map.poses(held + " graph.gnss_max_sigma=0.1"), without) == 0);
    CHECK(apart(map.poses(held + " graph.gnss_min_fixes=37"), without) == 0);
    CHECK(apart(map.poses(held + " graph.gnss_bias=10"), with) > 0.001);
    CHECK(apart(map.poses(held + " graph.gnss_correlation_time=100"), with) > 0.001);
    CHECK(apart(map.poses(held + " graph.gnss_antenna_y=3"), with) > 0.01);
  }

  TEST_CASE(
      "gravity holds a map upright, as long and as firmly as is set; without it the map is as without accelerations") {
    const LeaningMap map;
    const std::vector<SE3d> without = map.poses("graph.gravity=false"), with = map.poses("");
    CHECK(apart(map.poses_of_earlier(""), without) == 0);
    CHECK(apart(with, without) > 0.1);
    CHECK(height_range(with) < 0.3 * height_range(without));
    CHECK(apart(map.poses("graph.gravity_window=5"), with) > 0.001);
    CHECK(apart(map.poses("graph.gravity_deviation=5"), with) > 0.001);
    CHECK(apart(map.poses("graph.gravity_speed_deviation=10"), with) > 0.001);
    CHECK(apart(map.poses("graph.gravity_start_deviation=0.001"), with) > 0.01);
    const std::vector<SE3d> by_all = map.poses("graph.gravity_outlier_threshold=1e6");
    CHECK(apart(by_all, with) > 0.01);
    CHECK(height_range(by_all) > height_range(with));  // what is off by 20 degrees was rejected
  }

  TEST_CASE("a map does not depend on how many scans stay in memory, which is stated in MiB") {
    const RoundMap map;
    const std::string all = map.records("keyframes.scan_memory=1000000");
    CHECK(all.size() > 100'000);
    CHECK(all == map.records("keyframes.scan_memory=0"));  // the scan used last
    CHECK(all == map.records("keyframes.scan_memory=1"));
    const ScratchFolder scratch("scan_memory");
    CHECK(contains(run_program(scratch.path(), "config --print").output, "scan_memory = 32\n"));
    CHECK(run_program(scratch.path(), "config --print --set keyframes.scan_memory=-1").exit_code == 2);
  }

  TEST_CASE("a map whose scans hardly move is the same however many submaps are kept; their memory is in MiB") {
    const RoundMap map;
    CHECK(apart(map.poses("closures.submap_memory=1"), map.poses("")) == 0);
    const ScratchFolder scratch("submap_memory");
    CHECK(contains(run_program(scratch.path(), "config --print").output, "submap_memory = 64\n"));
    const ProgramResult none = run_program(scratch.path(), "config --print --set closures.submap_memory=0");
    CHECK(none.exit_code == 2);
    CHECK(contains(none.errors, "'closures.submap_memory' is out of range"));
  }
}
