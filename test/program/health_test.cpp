#include <doctest/doctest.h>

#include <algorithm>

#include "chainslam/io/map_archive.hpp"
#include "program/run_program.hpp"
#include "support/real_data.hpp"

namespace {

using namespace chainslam;
using namespace chainslam::test;

std::string first_line(const std::string& text) { return text.substr(0, text.find('\n')); }

/// KITTI's 228 raw sweeps about 2 m apart, with their IMU, as the program reads them.
std::string kitti_with_imu(const fs::path& folder) { return "map " + quoted(folder) + " --out "; }

}  // namespace

TEST_SUITE("program/health") {
  TEST_CASE("228 sweeps of KITTI begun at speed: FAST-LIO2 as published works, or its failure is in the first line" *
            doctest::skip(quick())) {
    const auto data = real_data("kitti00_keyframes_imu/kitti00_keyframes_imu/kitti00_keyframes_imu");
    if (!data) return;
    const ScratchFolder scratch("health");
    const fs::path out = scratch.path() / "out";
    const ProgramResult run =
        run_program(scratch.path(), kitti_with_imu(*data) + quoted(out) + " --set odometry.source=fast_lio2");
    CAPTURE(run.output);
    CAPTURE(run.errors);
    const nlohmann::json summary = summary_of(out);
    const nlohmann::json& health = summary["sessions"][0]["health"];
    const bool lost_many = health["lost_share"].get<double>() > 0.1 || health["map_restarts"].get<int>() > 0;
    std::printf("FIGURE %-60s %.4g %s\n", "kitti00_keyframes_imu by fast_lio2: scans lost",
                100 * health["lost_share"].get<double>(), "%");
    REQUIRE(lost_many == (run.exit_code == 5));
    REQUIRE(lost_many == !summary["verdict"]["good"].get<bool>());
    if (!lost_many) return;
    CHECK(contains(first_line(run.output), "failed"));
    CHECK(contains(first_line(run.output), "228 scans lost"));
    CHECK(contains(run.output.substr(run.output.rfind("verdict")), "not to be trusted"));
    CHECK(contains(run.output.substr(run.output.rfind("verdict")), "do: try"));
    const std::string report = read_text(out / "report.html");
    CHECK(report.find("failed: missed") < report.find("<dl class=\"figures\">"));
    CHECK(contains(report, "class=\"path lost\""));
    CHECK(contains(report, "Lost and doubtful intervals"));
    // The map is saved whole, with the health of every frame.
    const LoadedMap loaded = load_map(out / "map.cslam", {.scans = false});
    CHECK(loaded.report.complete);
    CHECK(to_index(loaded.map.frames.size()) == health["frames"].get<int>());
    CHECK(std::ranges::count_if(loaded.map.frames, [](const FrameRecord& frame) {
            return frame.health.status == FrameStatus::lost;
          }) == health["lost"].get<int>());
    CHECK(contains(run_program(scratch.path(), "inspect " + quoted(out / "map.cslam")).output, "scans lost"));
    // Whoever wants the map all the same says so: the first 60 sweeps, of which 11 are lost.
    CHECK(run_program(scratch.path(), kitti_with_imu(*data) + quoted(scratch.path() / "all_the_same") +
                                          " --set odometry.source=fast_lio2 --max-scans 60 --set "
                                          "goals.max_lost_share=1 --set goals.max_map_restarts=-1")
              .exit_code == 0);
  }

  TEST_CASE("where nothing is lost the verdict is good, and every frame has its row" * doctest::skip(quick())) {
    const auto data = real_data("nuscenes_scene/nuscenes_scene");
    if (!data) return;
    const ScratchFolder scratch("nothing_lost");
    const fs::path out = scratch.path() / "out";
    const ProgramResult run = run_program(
        scratch.path(), kitti_with_imu(*data) + quoted(out) + " --set odometry.source=lidar --set dataset.scan_rate=2");
    CAPTURE(run.output);
    CAPTURE(run.errors);
    REQUIRE(run.exit_code == 0);
    CHECK(first_line(run.output) == "verdict      good");
    const nlohmann::json summary = summary_of(out);
    CHECK(summary["verdict"]["good"] == true);
    CHECK(summary["sessions"][0]["health"]["frames"] == 39);
    const std::string table = read_text(out / "frames.csv");
    CHECK(std::ranges::count(table, '\n') == 40);
    const fs::path exported = scratch.path() / "exported";
    REQUIRE(
        run_program(scratch.path(), "export " + quoted(out / "map.cslam") + " --format tum --out " + quoted(exported))
            .exit_code == 0);
    CHECK(read_text(exported / "frames.csv") == table);
  }
}
