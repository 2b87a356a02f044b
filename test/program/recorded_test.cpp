#include <unistd.h>

#include <array>
#include <cmath>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include "chainslam/io/trajectory_file.hpp"
#include "program/run_program.hpp"
#include "support/real_data.hpp"

#include <doctest/doctest.h>

// `simulate --trajectory`: scans along a recorded trajectory, with the IMU data that were recorded on it.

namespace {

using namespace chainslam;
using namespace chainslam::test;

std::vector<std::string> lines(const std::string& text) {
  std::istringstream stream(text);
  std::vector<std::string> result;
  for (std::string line; std::getline(stream, line);) result.push_back(line);
  return result;
}

std::string first_lines(const fs::path& file, std::size_t count) {
  std::string text;
  std::ifstream stream(file);
  for (std::string line; count > 0 && std::getline(stream, line); --count) text += line + "\n";
  return text;
}

/// An arc of 80 m at 8 m/s, as TUM's trajectory; `change` may spoil a row.
template <class Change>
std::string arc(const Change& change) {
  std::string text;
  for (int i = 0; i <= 100; ++i) {
    const double t = 0.1 * i, turn = 0.2 * t;
    std::array<double, 8> row{1000.0 + t, 40.0 * std::sin(turn), 40.0 - 40.0 * std::cos(turn), 0.0, 0.0,
                              0.0,        std::sin(0.5 * turn),  std::cos(0.5 * turn)};
    change(i, row);
    for (const double value : row) text += std::to_string(value) + " ";
    text += "\n";
  }
  return text;
}

std::string arc() {
  return arc([](int, auto&) {});
}

void check_failure(const ProgramResult& result, int exit_code, const std::string& names) {
  CAPTURE(result.errors);
  CHECK(result.exit_code == exit_code);
  CHECK(contains(result.errors, names));
  CHECK(contains(result.errors, "\n  found: "));
  CHECK(contains(result.errors, "\n  do: "));
}

}  // namespace

TEST_SUITE("program/recorded") {
  TEST_CASE("a stretch of KITTI 07: IMU values unchanged, its lag kept, mapped from files and while simulated") {
    const auto data = real_data("kitti_imu");
    if (!data) return;
    const ScratchFolder scratch("recorded");
    const fs::path poses = scratch.path() / "07_truth.txt", imu = scratch.path() / "07_imu.csv";
    write_text(poses, first_lines(*data / "07_truth_camera.txt", 120));
    write_text(imu, first_lines(*data / "07_imu.csv", 1500));
    write_text(scratch.path() / "filled.txt", "06 0 50\n07 60.05 70.05\n");
    const std::string kitti = "simulate --trajectory " + quoted(poses) + " --rate 9.615 --imu " + quoted(imu) +
                              " --body-lidar kitti --camera-lidar kitti --columns 400 --skip " +
                              quoted(scratch.path() / "filled.txt");
    const fs::path drive = scratch.path() / "drive";
    const ProgramResult made = run_program(scratch.path(), kitti + " --out " + quoted(drive));
    CAPTURE(made.errors);
    REQUIRE(made.exit_code == 0);
    const std::string source =
        "simulated scans (HDL-64E) on the recorded trajectory 07_truth.txt, real IMU data from "
        "07_imu.csv";
    CHECK(contains(made.output, source));
    CHECK(contains(made.output, "stamped 6"));  // 60 to 69 ms late
    CHECK(contains(read_text(drive / "README.txt"), source));
    CHECK(lines(read_text(drive / "T_body_lidar.txt")).size() == 3);

    const auto given = lines(read_text(imu)), written = lines(read_text(drive / "imu.csv"));
    CHECK(written.front() == "timestamp,gx,gy,gz,ax,ay,az");
    std::size_t next = 1;
    for (std::size_t i = 1; i < given.size(); ++i) {
      const double frame = std::stod(given[i]);
      const double time = frame / 9.615;
      if ((frame > 60.05 && frame < 70.05) || time > 119 / 9.615 + 1.0) continue;
      REQUIRE(next < written.size());
      CHECK(written[next].substr(written[next].find(',')) == given[i].substr(given[i].find(',')));
      CHECK(std::abs(std::stod(written[next]) - time) < 1e-6);
      ++next;
    }
    CHECK(next == written.size());

    const fs::path recipe = scratch.path() / "recipe";
    REQUIRE(run_program(scratch.path(), kitti + " --no-scans --out " + quoted(recipe)).exit_code == 0);
    CHECK_FALSE(fs::exists(recipe / "scans"));
    const std::string lidar_only = " --set odometry.source=lidar --out ";
    const fs::path map = scratch.path() / "map";
    const ProgramResult mapped =
        run_program(scratch.path(), "map simulate:" + recipe.string() + lidar_only + quoted(map));
    CAPTURE(mapped.errors);
    REQUIRE(mapped.exit_code == 0);
    CHECK(contains(summary_of(map).dump(), source));
    CHECK(contains(read_text(map / "report.html"), source));
    CHECK(rmse(summary_of(map), "odometry") < 0.15);
    const fs::path from_files = scratch.path() / "from_files";
    REQUIRE(run_program(scratch.path(), "map " + quoted(drive) + lidar_only + quoted(from_files)).exit_code == 0);
    CHECK(contains(summary_of(from_files).dump(), source));
  }

  TEST_CASE("without IMU data they are simulated, which is said") {
    const ScratchFolder scratch("recorded_no_imu");
    write_text(scratch.path() / "arc.tum", arc());
    const ProgramResult made =
        run_program(scratch.path(), "simulate --trajectory " + quoted(scratch.path() / "arc.tum") +
                                        " --lidar vlp-16 --columns 200 --out " + quoted(scratch.path() / "drive"));
    CAPTURE(made.errors);
    REQUIRE(made.exit_code == 0);
    CHECK(contains(made.output, "simulated scans (VLP-16) on the recorded trajectory arc.tum, simulated IMU data"));
    CHECK(lines(read_text(scratch.path() / "drive/times.txt")).front() == "1000.000000000");
    const Trajectory truth = read_tum(scratch.path() / "drive/truth.tum");
    CHECK(truth.size() == 100);
    const double chord = (truth.poses.back().translation() - truth.poses.front().translation()).norm();
    CHECK(chord == doctest::Approx(2.0 * 40.0 * std::sin(0.99)).epsilon(0.01));
  }

  TEST_CASE("an interval at the start cuts the drive") {
    const ScratchFolder scratch("recorded_cut");
    write_text(scratch.path() / "arc.tum", arc());
    const fs::path drive = scratch.path() / "drive";
    REQUIRE(run_program(scratch.path(), "simulate --trajectory " + quoted(scratch.path() / "arc.tum") +
                                            " --no-scans --skip 999:1002 --out " + quoted(drive))
                .exit_code == 0);
    CHECK(read_tum(drive / "truth.tum").times.front() >= Timestamp(seconds(1002.0)));
  }

  TEST_CASE("drives through one world have their truths in one frame, which their recordings say") {
    const ScratchFolder scratch("recorded_world");
    write_text(scratch.path() / "a.tum", arc());
    write_text(scratch.path() / "b.tum", arc([](int, auto& row) { row[0] += 500; }));
    const auto truth_frame = [&](const std::string& drive, const std::string& also) {
      const fs::path out = scratch.path() / (drive + also), set = scratch.path() / ("set" + drive + also);
      const std::string others = also.empty() ? "" : " --also " + quoted(scratch.path() / (also + ".tum"));
      const ProgramResult made =
          run_program(scratch.path(), "simulate --no-scans --lidar vlp-16 --columns 200 --trajectory " +
                                          quoted(scratch.path() / (drive + ".tum")) + others + " --out " + quoted(out));
      CAPTURE(made.errors);
      REQUIRE(made.exit_code == 0);
      REQUIRE(run_program(scratch.path(), "odometry simulate:" + out.string() +
                                              " --max-scans 5 --set odometry.source=lidar --out " + quoted(set))
                  .exit_code == 0);
      return nlohmann::json::parse(read_text(set / "odometry.json"))["truth_frame"].get<std::string>();
    };
    const std::string shared = truth_frame("a", "b");
    CHECK_FALSE(shared.empty());
    CHECK(truth_frame("b", "a") == shared);
    CHECK(truth_frame("a", "").empty());
  }

  TEST_CASE("what cannot be used is refused with what to do") {
    const ScratchFolder scratch("recorded_errors");
    const fs::path file = scratch.path() / "bad.tum";
    const auto simulate = [&](const std::string& trajectory, const std::string& options = "") {
      write_text(file, trajectory);
      const fs::path out = scratch.path() / "drive";
      fs::remove_all(out);
      const ProgramResult result = run_program(
          scratch.path(), "simulate --trajectory " + quoted(file) + " --no-scans --out " + quoted(out) + " " + options);
      if (result.exit_code != 0) CHECK_FALSE(fs::exists(out));
      return result;
    };
    check_failure(simulate(arc([](int i, auto& row) { row[0] -= i == 50 ? 0.5 : 0.0; })), 3, "line 51");
    check_failure(simulate(arc([](int i, auto& row) { row[1] += i >= 50 ? 30.0 : 0.0; })), 3, "pose 51");
    check_failure(simulate(arc([](int i, auto& row) { row[0] += i >= 50 ? 3.0 : 0.0; })), 3, "a gap of 3.1 s");
    check_failure(simulate(arc([](int i, auto& row) { row[2] = i == 7 ? std::nan("") : row[2]; })), 3, "line 8");
    std::string brief = arc();
    brief.resize(brief.find("1000.500000"));
    check_failure(simulate(brief), 3, "5 poses");
    check_failure(simulate("1 0 0 0 0 1 0 0 0 0 1 0\n"), 2, "no times");
    check_failure(simulate(arc(), "--frame camera"), 2, "--camera-lidar");
    check_failure(simulate(arc(), "--lidar HDL-65E"), 2, "HDL-65E");
    check_failure(simulate(arc(), "--skip sometimes"), 2, "sometimes");
    const fs::path imu = scratch.path() / "imu.csv";
    const auto with_imu = [&](const std::string& text, const std::string& options = "") {
      write_text(imu, text);
      return simulate(arc(), "--imu " + quoted(imu) + " " + options);
    };
    const std::string header = "timestamp,gx,gy,gz,ax,ay,az\n";
    check_failure(with_imu(header + "900,0,0,0,0,0,9.8\n900.1,0,0,0,0,0,9.8\n"), 3, "--imu-offset");
    CHECK(with_imu(header + "902,0,0,0.2,0,1.6,9.8\n902.1,0,0,0.2,0,1.6,9.8\n", "--imu-offset 100").exit_code == 0);
    check_failure(with_imu(header + "1002,0,0,0,0,0,9.8\n1001,0,0,0,0,0,9.8\n"), 3, "line 3");
    check_failure(with_imu(header + "1002,0,0,0,0,0,nan\n"), 3, "line 2");
    check_failure(with_imu(header + "1002,0,0,0,0,0,1\n1003,0,0,0,0,0,1\n"), 2, "does not suit");
    check_failure(with_imu("nominal_frame,gx,gy,gz,ax,ay,az\n0.0,0,0,0,0,0,9.8\n"), 3, "nominal_frame");
    check_failure(with_imu("a,b\n"), 3, "header");
    const ProgramResult neither = run_program(scratch.path(), "simulate --out " + quoted(scratch.path() / "drive"));
    check_failure(neither, 2, "a preset or a trajectory");
  }
}
