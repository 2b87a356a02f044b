#include <unistd.h>

#include <cstdio>
#include <sstream>
#include <utility>
#include <vector>

#include "chainslam/io/trajectory_file.hpp"
#include "program/run_program.hpp"
#include "support/real_data.hpp"

#include <doctest/doctest.h>

namespace {

using namespace chainslam;
using namespace chainslam::test;

/// Prints a figure that test/run.sh shows.
void figure(const char* name, double value, const char* unit) {
  std::printf("FIGURE %-60s %.4g %s\n", name, value, unit);
}

/// Maps a data set and returns the folder of results.
fs::path map(const ScratchFolder& scratch, const fs::path& data, const std::string& name,
             const std::string& options = "") {
  const fs::path out = scratch.path() / name;
  const ProgramResult result =
      run_program(scratch.path(), "map " + quoted(data) + " --out " + quoted(out) + " " + options);
  CAPTURE(result.errors);
  REQUIRE(result.exit_code == 0);
  return out;
}

/// Maps a data set once more: every file has the same bytes.
void check_repeated(const ScratchFolder& scratch, const fs::path& data, const fs::path& first,
                    const std::string& options) {
  const fs::path second = map(scratch, data, "second", options);
  for (const auto& entry : fs::directory_iterator(first)) {
    const std::string name = entry.path().filename().string();
    if (name == "summary.json" || name == "report.html") continue;  // these state how long the run took
    CHECK_MESSAGE(read_text(entry.path()) == read_text(second / name), name);
  }
}

void figures_of_run(const char* name, const nlohmann::json& summary) {
  const std::string prefix = name;
  figure((prefix + ": times real time").c_str(), summary["times_real_time"].get<double>(), "");
  figure((prefix + ": odometry per scan, median").c_str(), summary["stages"]["odometry"]["p50_ms"].get<double>(), "ms");
  figure((prefix + ": peak memory").c_str(), summary["peak_memory_bytes"].get<double>() / 1e6, "MB");
}

}  // namespace

TEST_SUITE("program/sequences") {
  TEST_CASE("the embedded town drive: odometry drifts, closures mend it" * doctest::skip(quick())) {
    const ScratchFolder scratch("town");
    const fs::path town = scratch.path() / "town";
    const ProgramResult simulated = run_program(scratch.path(), "simulate town --out " + quoted(town));
    CAPTURE(simulated.errors);
    REQUIRE(simulated.exit_code == 0);
    // By scans alone, and with streets out of sight forgotten, odometry drifts.
    const std::string options = "--set odometry.source=lidar --set odometry.map_radius=30";
    const fs::path first = map(scratch, town, "first", options);
    const nlohmann::json summary = summary_of(first);
    const double odometry = rmse(summary, "odometry"), optimized = rmse(summary, "optimized");
    figure("town, by scans alone: APE of odometry", odometry, "m");
    figure("town, by scans alone: APE with closures", optimized, "m");
    figure("town: closures", summary["closures"]["direct"].get<double>(), "");
    figures_of_run("town", summary);
    CHECK(odometry >= 1.0);
    CHECK(odometry >= 3.0 * optimized);
    for (const auto& [which, file] :
         {std::pair("odometry", "odometry.tum"), std::pair("optimized", "trajectory.tum")}) {
      const nlohmann::json& of_run = summary["errors"][which]["kitti"];
      const fs::path json = scratch.path() / "eval.json";
      const std::string pair = quoted(town / "truth.tum") + " " + quoted(first / file);
      REQUIRE(
          run_program(scratch.path(), "eval " + pair + " --associate interpolate --overwrite --json " + quoted(json))
              .exit_code == 0);
      const nlohmann::json of_files = nlohmann::json::parse(read_text(json))["kitti"];
      CHECK(of_run["segments"] == of_files["segments"]);
      for (const char* figure : {"translation_percent", "rotation_deg_per_100m"})
        CHECK(of_run[figure].get<double>() == doctest::Approx(of_files[figure].get<double>()).epsilon(3e-3));
    }
    CHECK(contains(read_text(first / "report.html"), "Relative errors over 100 to 800 m"));

    // Where real data are at hand, two runs of them say the same in less time.
    if (full() || !find_real_data("kitti00_first101/kitti00_first101"))
      check_repeated(scratch, town, first, options + " --threads 1");
  }

  TEST_CASE("kitti00_first101 against SemanticKITTI's poses; one thread gives the same bytes" *
            doctest::skip(quick())) {
    const auto data = real_data("kitti00_first101/kitti00_first101");
    if (!data) return;
    const ScratchFolder scratch("kitti");
    const std::string options = "--truth " + quoted(*data / "poses_semantickitti.tum");
    const fs::path out = map(scratch, *data, "map", options);
    check_repeated(scratch, *data, out, options + " --threads 1");
    const nlohmann::json summary = summary_of(out);
    CHECK(summary["scans"] == 101);
    figure("kitti00_first101: APE", rmse(summary, "optimized"), "m");
    figures_of_run("kitti00_first101", summary);
    CHECK(rmse(summary, "optimized") <= 0.5);
    CHECK_FALSE(summary["errors"]["optimized"].contains("kitti"));  // 84 m: too short for any segment

    // NCLT's own axes are the wrong ones for these scans; taken all the same, the program says that they look wrong.
    const fs::path flipped = scratch.path() / "flipped";
    const ProgramResult wrong = run_program(scratch.path(), "map " + quoted(*data) + " --out " + quoted(flipped) +
                                                                " --set dataset.axes=nclt --max-scans 10");
    CHECK(wrong.exit_code == 0);
    CHECK((wrong.output + wrong.errors).find("axes") != std::string::npos);
  }

  TEST_CASE("muehlburger_tor: the car stands, then drives 292 m" * doctest::skip(quick())) {
    const auto data = real_data("muehlburger_tor/muehlburger_tor");
    if (!data) return;
    const ScratchFolder scratch("muehlburger");
    const fs::path out = map(scratch, *data, "map");
    const Trajectory trajectory = read_tum(out / "odometry.tum");
    REQUIRE(trajectory.size() == 501);  // the folder holds scans 0 to 500
    double moved = 0;
    for (std::size_t i = 0; i <= 100; ++i)
      moved = std::max(moved, (trajectory.poses[i].translation() - trajectory.poses[0].translation()).norm());
    figure("muehlburger_tor: farthest from the start in frames 0-100", moved, "m");
    CHECK(moved < 0.05);
    // The reference of 292 m was taken where the car moves; while it stands only noise would add to a sum of steps.
    double length = 0;
    Eigen::Vector3d last = trajectory.poses[0].translation();
    for (const SE3d& pose : trajectory.poses) {
      const double step = (pose.translation() - last).norm();
      if (step < 0.05) continue;
      length += step;
      last = pose.translation();
    }
    figure("muehlburger_tor: path", length, "m");
    figures_of_run("muehlburger_tor", summary_of(out));
    CHECK(length == doctest::Approx(292).epsilon(3.0 / 292));
  }

  TEST_CASE("hku_square_two_sessions: each session closes its loop; one thread gives the same bytes" *
            doctest::skip(quick())) {
    for (const char* session : {"session1", "session2"}) {
      const auto data = real_data(std::string("hku_square_two_sessions/") + session);
      if (!data) return;
      CAPTURE(session);
      const ScratchFolder scratch(session);
      const fs::path out = map(scratch, *data, "map");
      if (full() || session == std::string("session1")) check_repeated(scratch, *data, out, "--threads 1");
      const nlohmann::json summary = summary_of(out);
      CHECK(summary["closures"]["direct"].get<int>() >= 1);
      // Both return to their start; the data's own optimized poses say where the end lies as seen from there.
      const Trajectory ours = read_tum(out / "trajectory.tum");
      const Trajectory reference = read_kitti_poses(*data / "optimized_poses.txt");
      REQUIRE(ours.size() == reference.size());
      const SE3d ours_end = ours.poses.front().inverse() * ours.poses.back();
      const SE3d reference_end = reference.poses.front().inverse() * reference.poses.back();
      const double error = (ours_end.translation() - reference_end.translation()).norm();
      figure((std::string(session) + ": loop end against the reference").c_str(), error, "m");
      figure((std::string(session) + ": closures").c_str(), summary["closures"]["direct"].get<double>(), "");
      CHECK(error < 0.5);
      CHECK(ours_end.translation().norm() < 1.0);  // the walk ends where it began
    }
  }
}
