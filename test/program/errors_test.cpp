#include <unistd.h>

#include <cstdint>

#include "program/run_program.hpp"

#include <doctest/doctest.h>

namespace {

using namespace chainslam::test;

/// An error is three lines: what and where, what was found, what to do.
void check_error(const ProgramResult& result, int exit_code, const std::string& names) {
  CAPTURE(result.errors);
  CHECK(result.exit_code == exit_code);
  CHECK(contains(result.errors, "error: "));
  CHECK(contains(result.errors, names));
  CHECK(contains(result.errors, "\n  found: "));
  CHECK(contains(result.errors, "\n  do: "));
}

/// `count` scans of NCLT's velodyne_sync: a square of walls around the sensor, standing still.
void write_scans(const fs::path& folder, int count) {
  fs::create_directories(folder / "velodyne_sync");
  for (int scan = 0; scan < count; ++scan) {
    std::string bytes;
    const auto add = [&](double x, double y, double z) {
      for (const double value : {x, y, z}) {
        const auto coded = static_cast<std::uint16_t>((value + 100) / 0.005 + 0.5);
        bytes += static_cast<char>(coded & 255);
        bytes += static_cast<char>(coded >> 8);
      }
      bytes += std::string(2, '\0');
    };
    for (int i = -40; i <= 40; ++i) {
      for (int level = 0; level < 8; ++level) {
        const double along = i * 0.25, height = level * 0.4 - 1.5;  // z down: -1.5 is above the sensor
        add(10, along, height), add(-10, along, height), add(along, 10, height), add(along, -10, height);
      }
      for (int j = -40; j <= 40; ++j) add(i * 0.25, j * 0.25, 1.7);  // the ground, below: z is down
    }
    write_text(folder / "velodyne_sync" / (std::to_string(1'000'000'000'000'000 + scan * 100'000) + ".bin"), bytes);
  }
}

}  // namespace

TEST_SUITE("program/errors") {
  TEST_CASE("help and version are good, a wrong command line is 2") {
    const ScratchFolder scratch("usage");
    CHECK(run_program(scratch.path(), "--version").exit_code == 0);
    const ProgramResult help = run_program(scratch.path(), "--help");
    CHECK(help.exit_code == 0);
    for (const char* verb : {"map", "simulate", "inspect", "eval", "optimize", "config"})
      CHECK(contains(help.output, verb));
    for (const char* verb : {"map", "simulate", "inspect", "eval", "optimize", "config"})
      CHECK(run_program(scratch.path(), std::string(verb) + " --help").exit_code == 0);
    CHECK(run_program(scratch.path(), "").exit_code == 2);
    CHECK(run_program(scratch.path(), "mpa somewhere").exit_code == 2);
    CHECK(run_program(scratch.path(), "map somewhere --out there --no-such-option").exit_code == 2);
  }

  TEST_CASE("a missing, an empty and a strange input are 3, and say what to do") {
    const ScratchFolder scratch("input");
    const std::string out = " --out '" + (scratch.path() / "out").string() + "'";
    check_error(run_program(scratch.path(), "map '" + (scratch.path() / "nowhere").string() + "'" + out), 3, "nowhere");
    fs::create_directories(scratch.path() / "empty");
    check_error(run_program(scratch.path(), "map '" + (scratch.path() / "empty").string() + "'" + out), 3, "empty");
    write_text(scratch.path() / "poem.txt", "shall I compare thee\n");
    check_error(run_program(scratch.path(), "map '" + (scratch.path() / "poem.txt").string() + "'" + out), 3,
                "poem.txt");
    CHECK_FALSE(fs::exists(scratch.path() / "out"));
  }

  TEST_CASE("a truncated scan is left out, with a warning that names the file and the byte") {
    const ScratchFolder scratch("truncated");
    write_scans(scratch.path() / "data", 3);
    const fs::path scan = scratch.path() / "data/velodyne_sync/1000000000100000.bin";
    fs::resize_file(scan, fs::file_size(scan) - 3);
    const fs::path out = scratch.path() / "out";
    const ProgramResult result =
        run_program(scratch.path(), "map '" + (scratch.path() / "data").string() + "' --out '" + out.string() + "'");
    CAPTURE(result.errors);
    CHECK(result.exit_code == 0);
    CHECK(contains(result.errors, "\nwarning: 1 file "));
    CHECK(contains(result.errors, scan.filename().string() + ", byte "));
    CHECK(summary_of(out)["scans"] == 2);
    CHECK(contains(summary_of(out)["sessions"][0]["notes"].dump(), scan.filename().string()));
  }

  TEST_CASE("a good run writes every result, refuses to overwrite, and keeps the old result beside the new") {
    const ScratchFolder scratch("overwrite");
    write_scans(scratch.path() / "data", 8);
    const fs::path out = scratch.path() / "out";
    const std::string command = "map '" + (scratch.path() / "data").string() + "' --out '" + out.string() + "'";
    const ProgramResult first = run_program(scratch.path(), command);
    CAPTURE(first.errors);
    REQUIRE(first.exit_code == 0);
    for (const char* name :
         {"trajectory.tum", "trajectory.kitti.txt", "odometry.tum", "map.ply", "graph.g2o", "summary.json",
          "report.html", "config.toml", "keyframes.csv", "closures.csv", "frames.csv"})
      CHECK_MESSAGE(fs::exists(out / name), name);
    CHECK(summary_of(out)["scans"] == 8);

    write_text(out / "precious.txt", "mine");
    check_error(run_program(scratch.path(), command), 4, "out");
    CHECK(fs::exists(out / "precious.txt"));
    REQUIRE(run_program(scratch.path(), command + " --overwrite").exit_code == 0);
    CHECK_FALSE(fs::exists(out / "precious.txt"));
    CHECK(read_text(scratch.path() / "out~1" / "precious.txt") == "mine");
    CHECK(read_text(out / "map.ply") == read_text(scratch.path() / "out~1" / "map.ply"));
  }

  TEST_CASE("an output that cannot be written is 4, and what stood there stays") {
    const ScratchFolder scratch("output");
    write_scans(scratch.path() / "data", 4);
    const std::string command = "map '" + (scratch.path() / "data").string() + "' --out ";
    check_error(run_program(scratch.path(), command + "/proc/no/such/place"), 4, "/proc/no");
    write_text(scratch.path() / "file", "a file, not a folder");
    check_error(run_program(scratch.path(), command + "'" + (scratch.path() / "file" / "map").string() + "'"), 4,
                "file");

    // A full disk: no file may grow past 8 KiB (blocks of 1 KiB), and writing more fails instead of raising a signal.
    const fs::path out = scratch.path() / "out";
    REQUIRE(run_program(scratch.path(), command + "'" + out.string() + "'").exit_code == 0);
    const std::string before = read_text(out / "map.ply");
    const ProgramResult full =
        run_program(scratch.path(), command + "'" + out.string() + "' --overwrite", "trap '' XFSZ; ulimit -f 8;");
    check_error(full, 4, "out");
    CHECK(read_text(out / "map.ply") == before);
    CHECK_FALSE(fs::exists(scratch.path() / "out~1"));
  }

  TEST_CASE("NaN and far points in scans are dropped, and an all-empty data set is an error") {
    const ScratchFolder scratch("empty_scans");
    fs::create_directories(scratch.path() / "data/velodyne_sync");
    for (int scan = 0; scan < 3; ++scan)
      write_text(scratch.path() / "data/velodyne_sync" / (std::to_string(1'000'000 + scan * 100'000) + ".bin"), "");
    check_error(run_program(scratch.path(), "map '" + (scratch.path() / "data").string() + "' --out '" +
                                                (scratch.path() / "out").string() + "'"),
                3, "data");
  }

  TEST_CASE("configuration errors are 2 and name line, column and the nearest key") {
    const ScratchFolder scratch("configuration");
    write_scans(scratch.path() / "data", 2);
    const fs::path config = scratch.path() / "bad.toml";
    const std::string command = "map '" + (scratch.path() / "data").string() + "' --out '" +
                                (scratch.path() / "out").string() + "' --config '" + config.string() + "'";
    write_text(config, "[odometry]\nvoxel_sise = 0.5\n");
    const ProgramResult unknown = run_program(scratch.path(), command);
    check_error(unknown, 2, "line 2");
    CHECK(contains(unknown.errors, "voxel_size"));
    write_text(config, "[odometry]\nvoxel_size = \"wide\"\n");
    check_error(run_program(scratch.path(), command), 2, "voxel_size");
    write_text(config, "[odometry]\nvoxel_size = nan\n");
    check_error(run_program(scratch.path(), command), 2, "voxel_size");
    write_text(config, "[odometry\n");
    check_error(run_program(scratch.path(), command), 2, "line 1");
    CHECK(run_program(scratch.path(), "config --print").exit_code == 0);
    CHECK(contains(run_program(scratch.path(), "config --explain odometry.voxel_size").output, "voxel"));
  }

  TEST_CASE("an extrinsic that is no pose is 2 and names the line; what is set reaches the data set") {
    const ScratchFolder scratch("extrinsic");
    write_text(scratch.path() / "site.toml", "[dataset]\nT_body_lidar = [0, 0, 1]\n");
    const std::string config = "--config " + quoted(scratch.path() / "site.toml");
    write_scans(scratch.path() / "data", 1);
    const std::string data = quoted(scratch.path() / "data");
    check_error(run_program(scratch.path(), "inspect " + data + " " + config), 2, "site.toml, line 2");
    check_error(run_program(scratch.path(), "inspect " + data + " --set dataset.T_body_lidar=[0,0,0,0,0,1,1]"), 2,
                "quaternion qx qy qz qw of length 1.4");
    write_text(scratch.path() / "site.toml", "[dataset]\nT_body_lidar = [0.5, 0, 1, 0, 0, 90]\n");
    const ProgramResult inspected = run_program(scratch.path(), "inspect " + data + " " + config);
    CHECK(inspected.exit_code == 0);
    CHECK(contains(inspected.output, "0.5 0 1 m, turned by 90 deg"));
    CHECK(contains(inspected.output, "as set by dataset.T_body_lidar; that of the release's calibration is not used"));
    const ProgramResult printed = run_program(scratch.path(), "config --print " + config);
    write_text(scratch.path() / "again.toml", printed.output);
    CHECK(run_program(scratch.path(), "config --print --config " + quoted(scratch.path() / "again.toml")).output ==
          printed.output);
  }

  TEST_CASE("an out_of_range row of the IMU changes nothing, and is told") {
    const ScratchFolder scratch("absurd_row");
    const auto run = [&](const std::string& name, int out_of_range, const std::string& settings) {
      const fs::path data = scratch.path() / name;
      write_scans(data, 12);
      std::string rows;
      for (int i = 0; i < 200; ++i) {
        const std::string noise = std::to_string(1e-4 * (i % 7)), gravity = std::to_string(-9.8 + 1e-3 * (i % 5));
        rows += std::to_string(999'999'500'000'000 + i * 10'000) + ",0,0,0," + noise + "," + noise + "," + gravity +
                "," + (i == out_of_range ? "1e30" : noise) + "," + noise + ",0\n";
      }
      write_text(data / "ms25.csv", rows);
      const std::string out = quoted(scratch.path() / (name + "_map"));
      const ProgramResult result = run_program(scratch.path(), "map " + quoted(data) + " --out " + out + settings);
      CAPTURE(result.errors);
      CHECK(result.exit_code == 0);
      CHECK(contains(result.errors, "1 IMU samples rejected: beyond what any IMU measures") ==
            (out_of_range >= 0 && settings.empty()));
      CHECK(contains(run_program(scratch.path(), "inspect " + quoted(data)).output, "! 1 IMU samples rejected") ==
            (out_of_range >= 0));
      return summary_of(scratch.path() / (name + "_map"))["sessions"][0];
    };
    CHECK(run("good", -1, "")["imu"]["rejected"]["out_of_range"] == 0);
    const auto spoilt = run("spoilt", 80, "");
    CHECK(spoilt["imu"]["rejected"]["out_of_range"] == 1);
    CHECK(spoilt["imu"]["samples"] == 200);
    CHECK(spoilt["frames"]["lost"] == 0);
    CHECK(spoilt["path_length_m"].get<double>() < 0.05);  // it stands
    CHECK(!run("unused", 80, " --set imu.use=none").contains("imu"));
  }

  TEST_CASE("what config --print writes is a configuration that is read back") {
    const ScratchFolder scratch("round_trip");
    const ProgramResult printed = run_program(scratch.path(), "config --print");
    const fs::path config = scratch.path() / "printed.toml";
    write_text(config, printed.output);
    CHECK(run_program(scratch.path(), "config --check '" + config.string() + "'").exit_code == 0);
    CHECK(run_program(scratch.path(), "config --print --config '" + config.string() + "'").output == printed.output);
  }

  TEST_CASE("eval of trajectories that are empty, of one pose, or apart in time is 3") {
    const ScratchFolder scratch("eval");
    const fs::path one = scratch.path() / "one.tum", empty = scratch.path() / "empty.tum",
                   late = scratch.path() / "late.tum";
    write_text(one, "1.0 0 0 0 0 0 0 1\n");
    write_text(empty, "");
    write_text(late, "1000.0 0 0 0 0 0 0 1\n1001.0 1 0 0 0 0 0 1\n1002.0 1 1 0 0 0 0 1\n");
    check_error(run_program(scratch.path(), "eval '" + one.string() + "' '" + one.string() + "'"), 3, "one.tum");
    check_error(run_program(scratch.path(), "eval '" + late.string() + "' '" + empty.string() + "'"), 3, "empty.tum");
    check_error(run_program(scratch.path(), "eval '" + late.string() + "' '" + one.string() + "'"), 3, "one.tum");
    CHECK(run_program(scratch.path(), "eval '" + late.string() + "' '" + late.string() + "'").exit_code == 0);
  }

  TEST_CASE("Ctrl-C saves what there is and ends with 130") {
    const ScratchFolder scratch("interrupt");
    write_scans(scratch.path() / "data", 400);
    const fs::path out = scratch.path() / "out";
    const ProgramResult result =
        run_program(scratch.path(), "map '" + (scratch.path() / "data").string() + "' --out '" + out.string() + "'",
                    "timeout --foreground --preserve-status -s INT 1.5");
    CAPTURE(result.errors);
    if (result.exit_code == 0) {
      CHECK(summary_of(out)["scans"] == 400);  // it was faster than the signal
    } else {
      CHECK(result.exit_code == 130);
      CHECK(summary_of(out)["interrupted"] == true);
      CHECK(summary_of(out)["scans"] > 0);
      CHECK(fs::exists(out / "trajectory.tum"));
    }
  }
}
