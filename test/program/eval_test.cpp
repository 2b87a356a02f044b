#include <doctest/doctest.h>

#include <cmath>
#include <cstdio>

#include "program/run_program.hpp"
#include "support/real_data.hpp"

using namespace chainslam::test;

namespace {

/// What `eval` writes as JSON; the run must end well.
nlohmann::json evaluate(const ScratchFolder& scratch, const std::string& arguments) {
  const fs::path json = scratch.path() / "eval.json";
  const ProgramResult result = run_program(scratch.path(), "eval " + arguments + " --overwrite --json " + quoted(json));
  CAPTURE(arguments);
  CAPTURE(result.errors);
  REQUIRE(result.exit_code == 0);
  return nlohmann::json::parse(read_text(json));
}

double ape(const nlohmann::json& found, const char* figure) {
  return found["ape"]["translation"][figure].get<double>();
}

/// A square of 40 m, a pose each metre and second from `start` on, as TUM writes it, raised by `height`.
std::string square(double start, double height) {
  std::string text;
  for (int i = 0; i < 40; ++i) {
    const int side = i / 10, along = i % 10;
    const double xs[] = {1.0 * along, 10, 10.0 - along, 0}, ys[] = {0, 1.0 * along, 10, 10.0 - along};
    char line[128];
    std::snprintf(line, sizeof line, "%.1f %.1f %.1f %.1f 0 0 0 1\n", start + i, xs[side], ys[side], height);
    text += line;
  }
  return text;
}

}  // namespace

TEST_SUITE("program/eval") {
  TEST_CASE("the figures of KITTI 00 are evo's") {
    const auto data = real_data("trajectories/evo");
    if (!data) return;
    const ScratchFolder scratch("eval_kitti");
    const std::string pair = quoted(*data / "KITTI_00_gt.txt") + " " + quoted(*data / "KITTI_00_ORB.txt");
    const auto aligned = evaluate(scratch, pair + " --delta 10m");
    CHECK(std::abs(ape(aligned, "rmse") - 1.303450) < 1e-6);
    CHECK(std::abs(ape(aligned, "max") - 3.587949) < 1e-6);
    CHECK(std::abs(aligned["rpe"]["translation"]["rmse"].get<double>() - 0.226261) < 1e-6);
    CHECK(aligned["ape"]["count"] == 4541);
    CHECK(aligned["ape"]["rotation_deg"]["rmse"].get<double>() < 1.0);
    const auto& kitti = aligned["kitti"];  // ORB-SLAM2's published 0.70 % and 0.25 deg/100 m
    CHECK(std::abs(kitti["translation_percent"].get<double>() - 0.6997) < 1e-4);
    CHECK(std::abs(kitti["rotation_deg_per_100m"].get<double>() - 0.2533) < 1e-4);
    CHECK(std::abs(kitti["rotation_deg_per_m"].get<double>() - 0.002533) < 1e-6);
    CHECK(kitti["segments"] == 3283);
    CHECK(kitti["lengths"].size() == 8);
    CHECK(kitti["lengths"][7]["length"] == 800);
    CHECK(std::abs(kitti["lengths"][7]["translation_percent"].get<double>() - 0.41586) < 1e-4);
    const auto dense = evaluate(scratch, pair + " --kitti-step 1");
    CHECK(dense["kitti"]["segments"].get<int>() > 9 * 3283);
    CHECK(std::abs(dense["kitti"]["translation_percent"].get<double>() - 0.6997) < 0.01);
    CHECK(std::abs(ape(evaluate(scratch, pair + " --align none"), "rmse") - 7.790289) < 1e-6);
  }

  TEST_CASE("the figures of NCLT's sessions are those stated with the data") {
    const auto data = real_data("trajectories/nclt");
    if (!data) return;
    const ScratchFolder scratch("eval_nclt");
    const std::pair<const char*, double> sessions[] = {
        {"2012-01-08", 5.323}, {"2012-04-29", 2.472}, {"2012-08-04", 8.883}};
    std::string all;
    for (const auto& [session, stated] : sessions) {
      const fs::path folder = *data / session;
      const std::string pair = quoted(folder / "groundtruth.csv") + " " + quoted(folder / "odometry.tum");
      CHECK(std::abs(ape(evaluate(scratch, pair + " --associate index"), "rmse") - stated) < 5e-4);
      all += pair + " ";
    }
    // The truth of all sessions is in one frame, each odometry in its own: one alignment cannot fit all three.
    CHECK(ape(evaluate(scratch, all + "--associate index"), "rmse") > 8.883);
  }

  TEST_CASE("formats are told by content, and times of different kinds meet") {
    const auto data = real_data("trajectories/evo");
    if (!data) return;
    const ScratchFolder scratch("eval_formats");
    const auto found = evaluate(scratch, quoted(*data / "V102_groundtruth.csv") + " " + quoted(*data / "V102.txt"));
    CHECK(found["sessions"][0]["reference"]["format"] == "EuRoC csv");
    CHECK(found["sessions"][0]["estimate"]["format"] == "TUM");
    CHECK(found["sessions"][0]["matched"] == 794);
    CHECK(found["sessions"][0]["estimate_left_over"]["after"] == 9);
    CHECK(ape(found, "rmse") < 0.1);
  }

  TEST_CASE("sessions under one alignment keep the error between them") {
    const ScratchFolder scratch("eval_sessions");
    const fs::path first = scratch.path() / "first.tum", second = scratch.path() / "second.tum",
                   raised = scratch.path() / "raised.tum";
    write_text(first, square(0, 0));
    write_text(second, square(1000, 0));
    write_text(raised, square(1000, 4));
    const std::string both = quoted(first) + " " + quoted(first) + " " + quoted(second) + " " + quoted(raised);
    const auto found = evaluate(scratch, both);
    CHECK(found["sessions"].size() == 2);
    CHECK(found["ape"]["count"] == 80);
    CHECK(found["rpe"]["count"] == 78);
    CHECK(ape(found, "rmse") == doctest::Approx(2));  // half of the step between the two
    CHECK(ape(evaluate(scratch, quoted(second) + " " + quoted(raised)), "rmse") < 1e-9);
    CHECK(ape(evaluate(scratch, both + " --project xy"), "rmse") < 1e-9);
  }

  TEST_CASE("what was left over is said with its reason") {
    const ScratchFolder scratch("eval_left_over");
    const fs::path reference = scratch.path() / "reference.tum", late = scratch.path() / "late.tum";
    write_text(reference, square(0, 0));
    write_text(late, square(25, 0));
    const ProgramResult result = run_program(scratch.path(), "eval " + quoted(reference) + " " + quoted(late));
    REQUIRE(result.exit_code == 0);
    CHECK(contains(result.output, "matched    15 by time"));
    CHECK(contains(result.output, "25 of the reference left over: 25 before the estimate"));
    CHECK(contains(result.output, "25 of the estimate left over: 25 after the reference"));
    CHECK(contains(result.output, "KITTI: no path is longer than 100 m"));
    const auto found = evaluate(scratch, quoted(reference) + " " + quoted(late));
    CHECK(found["kitti"]["status"] == "path_too_short");
    CHECK(found["kitti"]["segments"] == 0);
  }

  TEST_CASE("a limit that is exceeded ends with 5, a wrong word with 2, an output that cannot be written with 4") {
    const ScratchFolder scratch("eval_codes");
    const fs::path low = scratch.path() / "low.tum", high = scratch.path() / "high.tum";
    write_text(low, square(0, 0));
    write_text(high, square(0, 3));
    const std::string pair = "eval " + quoted(low) + " " + quoted(high) + " --align none";
    CHECK(run_program(scratch.path(), pair + " --max-ape 3.1").exit_code == 0);
    const ProgramResult missed = run_program(scratch.path(), pair + " --max-ape 2.9");
    CHECK(missed.exit_code == 5);
    CHECK(contains(missed.errors, "missed: APE rmse of 3 m exceeds the limit of 2.9 m"));
    CHECK(run_program(scratch.path(), pair + " --delta 1000m --max-rpe 1").exit_code == 5);
    CHECK(run_program(scratch.path(), pair + " --align rigid").exit_code == 2);
    CHECK(run_program(scratch.path(), pair + " --delta 3cm").exit_code == 2);
    CHECK(run_program(scratch.path(), pair + " --kitti-step 0").exit_code == 2);
    CHECK(run_program(scratch.path(), "eval " + quoted(low)).exit_code == 2);
    CHECK(run_program(scratch.path(), pair + " --json /proc/eval.json").exit_code == 4);
  }
}
