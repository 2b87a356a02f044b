#include "merged_map.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/io/trajectory_file.hpp"
#include "datasets/odometry_recording.hpp"
#include "keyframe_sets.hpp"
#include "lamm/circle_drives.hpp"
#include "output.hpp"
#include "results.hpp"
#include "support/files.hpp"

namespace chainslam::lamm {
namespace {

/// Writes a drive as `chainslam odometry` does, with the truth of each frame.
void record(const Drive& drive, const std::vector<SE3d>& truth, const std::filesystem::path& folder) {
  std::filesystem::create_directories(folder);
  datasets::OdometryRecording recording(folder);
  PointCloud<float> cloud;
  for (int i = 0; i < 30; ++i) cloud.positions.emplace_back(1.F + static_cast<float>(i), 2.F, 3.F);
  std::size_t next = 0;
  for (Index i = 0; i < drive.frames(); ++i) {
    FrameRecord frame;
    frame.time = drive.odometry.times[static_cast<std::size_t>(i)];
    frame.T_odom_body = drive.pose(i);
    std::optional<Keyframe> keyframe;
    if (next < drive.scans.size() && drive.scans[next].frame == i) {
      ++next;
      keyframe = Keyframe{.time = frame.time,
                          .T_odom_body = frame.T_odom_body,
                          .cloud = std::make_shared<const PointCloud<float>>(cloud)};
    }
    recording.add(frame, keyframe);
  }
  recording.finish({.session = folder.filename().string(), .odometry = "lidar", .truth_frame = "circle"},
                   Trajectory{.times = drive.odometry.times, .poses = truth});
}

/// Two drives around a circle as sets, read again; the second a minute after the first.
std::vector<KeyframeSet> recorded_sets(test::TwoDrives& two, const test::TemporaryFolder& folder) {
  for (Timestamp& time : two.drives[1].odometry.times) time = time + seconds(160);
  std::vector<KeyframeSet> sets;
  for (std::size_t i = 0; i < 2; ++i) {
    const std::filesystem::path path = folder / ("drive" + std::to_string(i + 1));
    record(two.drives[i], two.truths[i], path);
    sets.push_back(read_keyframe_set(path));
  }
  return sets;
}

}  // namespace

TEST_SUITE("lamm/keyframe_sets") {
  TEST_CASE("a recorded set is read with every frame, the scans of the keyframes, and the truth") {
    Rng rng(1);
    test::TwoDrives two = test::two_drives(rng, 1e-3);
    const test::TemporaryFolder folder;
    const std::vector<KeyframeSet> sets = recorded_sets(two, folder);
    for (std::size_t i = 0; i < 2; ++i) {
      const Drive &drive = sets[i].drive, &written = two.drives[i];
      CHECK(drive.name == "drive" + std::to_string(i + 1));
      REQUIRE(drive.frames() == written.frames());
      for (Index k = 0; k < drive.frames(); ++k)
        CHECK((drive.pose(k).translation() - written.pose(k).translation()).norm() < 1e-12);
      CHECK(drive.odometry.times == written.odometry.times);
      CHECK(std::ranges::equal(drive.scans, written.scans, {}, &Scan::frame, &Scan::frame));
      CHECK(drive.scans.front().cloud->size() == 30);
      CHECK(sets[i].keyframes.size() == drive.scans.size());
      CHECK(sets[i].frames.size() == static_cast<std::size_t>(drive.frames()));
      REQUIRE(sets[i].truth);
      CHECK(sets[i].truth->size() == two.truths[i].size());
      CHECK(sets[i].truth_frame == "circle");
    }
  }

  TEST_CASE("what is no keyframe set is refused with the remedy") {
    const test::TemporaryFolder folder;
    CHECK(test::says(test::io_error([&] { return read_keyframe_set(folder / "absent"); }), "no such file"));
    std::filesystem::create_directories(folder / "clouds");
    test::write_bytes(folder / "clouds/1.ply",
                      "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float "
                      "z\nend_header\n1 2 3\n");
    CHECK(test::says(test::io_error([&] { return read_keyframe_set(folder / "clouds"); }), "chainslam odometry"));
  }
}

TEST_SUITE("lamm/merged_map") {
  TEST_CASE("what was merged has the mapper's errors and files") {
    Rng rng(2);
    test::TwoDrives two = test::two_drives(rng, 3e-4);
    const test::TemporaryFolder folder;
    std::vector<KeyframeSet> sets = recorded_sets(two, folder);
    Result result;
    result.loops = test::loops_between(two, 30);
    result.loops.push_back(test::true_loop(1, 950, 1, 10, two.truths));
    result.loops.push_back(result.loops.front());
    result.loops.back().kept = false;
    const ScanGraphOptions graph;
    result.drives = optimize_drives(std::vector<Drive>{sets[0].drive, sets[1].drive}, result.loops, graph);
    mapper::MappingResult mapping = mapping_result(std::move(sets), result, graph);

    const SlamMap& map = *mapping.map;
    CHECK(map.sessions[1].frame == SessionId{0});
    CHECK(map.keyframes.size() == 200);
    CHECK(map.odometry.size() == 198);
    CHECK(map.frames.size() == 2000);
    CHECK(map.closures.size() == 31);
    CHECK(std::ranges::count(map.closures, ClosureKind::direct, &LoopClosure::kind) == 1);
    REQUIRE(map.refusals.size() == 1);
    CHECK(map.refusals[0].verdict == ClosureVerdict::inconsistent);
    for (const LoopClosure& closure : map.closures) {
      const Keyframe& to = map.keyframes[static_cast<std::size_t>(closure.to.value)];
      const Keyframe& from = map.keyframes[static_cast<std::size_t>(closure.from.value)];
      CHECK(to.session == SessionId{1});
      CHECK(((from.T_map_body * closure.T_from_to).translation() - to.T_map_body.translation()).norm() < 1.0);
    }
    CHECK(mapping.figures.merges == 1);
    CHECK(mapping.truths_share_frame);

    const mapper::MapperOptions settings;
    const mapper::RunOutcome outcome = mapper::conclude(std::move(mapping), "two drives", settings);
    REQUIRE(outcome.optimized_errors);
    CHECK(outcome.optimized_errors->sessions == 2);
    CHECK(outcome.optimized_errors->alignments == 1);
    CHECK(outcome.optimized_errors->translation.rmse < 0.5);
    REQUIRE(outcome.inter_session_errors);
    CHECK(outcome.inter_session_errors->translation.rmse < 0.3);
    CHECK(outcome.summary.merge_closures == 30);
    CHECK(outcome.summary.merges == 1);

    mapper::OutputFolder out(folder / "out", false);
    mapper::write_results(out, outcome, settings);
    out.commit();
    for (const char* name : {"trajectory.tum", "trajectory.drive1.tum", "trajectory.drive2.tum", "odometry.drive2.tum"})
      CHECK(std::filesystem::exists(folder / "out" / name));
    const Trajectory written = read_tum(folder / "out/trajectory.drive2.tum");
    REQUIRE(written.size() == 1000);
    CHECK((written.poses[990].translation() - result.drives.poses[1].back().translation()).norm() < 1e-6);
  }

  TEST_CASE("sessions that nothing connects keep frames of their own, and are not compared") {
    Rng rng(3);
    test::TwoDrives two = test::two_drives(rng, 3e-4);
    const test::TemporaryFolder folder;
    std::vector<KeyframeSet> sets = recorded_sets(two, folder);
    Result result;
    result.drives = optimize_drives(std::vector<Drive>{sets[0].drive, sets[1].drive}, {}, {});
    const mapper::RunOutcome outcome =
        mapper::conclude(mapping_result(std::move(sets), result, {}), "two drives", mapper::MapperOptions{});
    CHECK(outcome.mapping.map->sessions[1].frame == SessionId{1});
    CHECK(outcome.optimized_errors->alignments == 2);
    CHECK(!outcome.inter_session_errors);
    CHECK(outcome.summary.merges == 0);
  }

  TEST_CASE("counts are written as JSON") {
    Rng rng(4);
    const test::TwoDrives two = test::two_drives(rng, 3e-4);
    Result result;
    result.loops = test::loops_between(two, 5);
    result.loops.front().kept = false;
    result.counts = {.key_clouds = 7, .keypoints = 8, .triangles = 9, .pairs = 3};
    const auto json = nlohmann::json::parse(lamm_json(result, as_released(), true));
    CHECK(json.at("as_released") == true);
    CHECK(json.at("key_clouds") == 7);
    CHECK(json.at("triangles") == 9);
    CHECK(json.at("session_pairs") == 3);
    CHECK(json.at("loops").at("between_sessions").at("verified") == 5);
    CHECK(json.at("loops").at("between_sessions").at("kept") == 4);
    CHECK(json.at("loops").at("within_sessions").at("verified") == 0);
  }
}

}  // namespace chainslam::lamm
