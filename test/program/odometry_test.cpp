#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <iterator>
#include <string>

#include "chainslam/io/map_archive.hpp"
#include "program/keyframe_data.hpp"
#include "program/run_program.hpp"
#include "support/real_data.hpp"

// `odometry`: what it records is a data set, and mapping that gives the map of the data themselves.

namespace {

using namespace chainslam;
using namespace chainslam::test;

ProgramResult good(const ScratchFolder& scratch, const std::string& arguments) {
  ProgramResult result = run_program(scratch.path(), arguments);
  CAPTURE(result.output);
  CAPTURE(result.errors);
  REQUIRE(result.exit_code == 0);
  return result;
}

/// How many frames of a map have what the accelerometer measured before them.
std::ptrdiff_t frames_with_acceleration(const fs::path& map) {
  const LoadedMap loaded = load_map(map, {.scans = false});
  return std::ranges::count_if(loaded.map.frames,
                               [](const FrameRecord& frame) { return frame.delta_velocity.has_value(); });
}

/// Records, maps both ways with the same settings, and compares the bytes.
/// @param accelerations  how many frames of the map have them at least; 0: none has.
void check_same_map(const std::string& data, const std::string& settings, bool intensities, int accelerations) {
  const ScratchFolder scratch("odometry");
  const fs::path set = scratch.path() / "set", direct = scratch.path() / "direct",
                 recorded = scratch.path() / "recorded";
  good(scratch, "odometry " + data + settings + " --out " + quoted(set));
  good(scratch, "map " + data + settings + " --out " + quoted(direct));
  good(scratch, "map " + quoted(set) + settings + " --threads 1 --out " + quoted(recorded));
  CHECK(read_pcd(set / "Scans/000000.pcd").has_intensities() == intensities);
  CHECK(read_text(direct / "map.cslam").size() > 100'000);
  CHECK(read_text(direct / "map.cslam") == read_text(recorded / "map.cslam"));
  const std::ptrdiff_t measured = frames_with_acceleration(recorded / "map.cslam");
  CHECK(measured >= accelerations);
  CHECK((measured > 0) == (accelerations > 0));
  CHECK(read_text(direct / "odometry.tum") == read_text(recorded / "odometry.tum"));
  CHECK(summary_of(direct)["keyframes"] == summary_of(recorded)["keyframes"]);
  if (summary_of(direct)["errors"].contains("odometry"))
    CHECK(rmse(summary_of(direct), "odometry") == rmse(summary_of(recorded), "odometry"));
}

/// Linear in a point's place, so that the mean over a voxel belongs to the mean of its points.
float intensity_at(const Eigen::Vector3f& p) { return 100 + p.x() + 2 * p.y() + 4 * p.z(); }

/// A folder of ten clouds, 0.5 m apart in a walled place.
void write_clouds_with_intensities(const fs::path& folder) {
  fs::create_directories(folder);
  Rng rng(3);
  const std::vector<Eigen::Vector3f> place = walled_place(rng, 400);
  for (int i = 0; i < 10; ++i) {
    PointCloud<float> cloud = transformed(place, SE3d(SO3d(), {-0.5 * i, 0, 0}));
    for (const Eigen::Vector3f& p : cloud.positions) cloud.intensities.push_back(intensity_at(p));
    char name[32];
    std::snprintf(name, sizeof name, "%06d.pcd", i);
    write_pcd(folder / name, cloud);
  }
}

}  // namespace

TEST_SUITE("program/odometry") {
  TEST_CASE("a recording has each point's intensity, of whole scans and of downsampled ones") {
    const ScratchFolder scratch("recorded_points");
    const fs::path clouds = scratch.path() / "clouds";
    write_clouds_with_intensities(clouds);
    for (const std::string settings : {"--set odometry.source=lidar --set keyframes.voxel_size=0.4",
                                       "--set odometry.source=lidar_inertial --set keyframes.voxel_size=0"}) {
      CAPTURE(settings);
      const fs::path set = scratch.path() / "set";
      fs::remove_all(set);
      good(scratch, "odometry " + quoted(clouds) + " " + settings + " --set keyframes.distance=1 --out " + quoted(set));
      int scans = 0;
      for (const auto& file : fs::directory_iterator(set / "Scans")) {
        const PointCloud<float> scan = read_pcd(file.path());
        CHECK(scan.size() > 3'000);
        REQUIRE(scan.has_intensities());
        float worst = 0;
        for (std::size_t i = 0; i < scan.size(); ++i)
          worst = std::max(worst, std::abs(scan.intensities[i] - intensity_at(scan.positions[i])));
        CHECK(worst < 7 * 0.005F + 1e-3F);  // coordinates are rounded to 0.01 m
        ++scans;
      }
      CHECK(scans >= 4);
      CHECK(contains(good(scratch, "inspect " + quoted(set)).output, "; with intensities"));
    }
  }

  TEST_CASE("a map of recorded odometry is the map of the data, bit for bit: simulated, with fixes") {
    check_same_map("simulate:nclt-like/small/1", " --max-scans 250 --set odometry.source=lidar", true, 0);
  }

  TEST_CASE("a map of recorded odometry is the map of the data, bit for bit: simulated, with accelerations") {
    check_same_map("simulate:nclt-like/small/1", " --max-scans 150", true, 120);
  }

  TEST_CASE("a map of recorded odometry is the map of the data, bit for bit: KITTI with its IMU" *
            doctest::skip(quick())) {
    if (const auto data = real_data("kitti00_keyframes_imu/kitti00_keyframes_imu/kitti00_keyframes_imu"))
      check_same_map(quoted(*data), " --max-scans 80", false, 60);
  }

  TEST_CASE("a recording is inspected, mapped with other settings, and not recorded again") {
    const auto data = real_data("kitti00_first101/kitti00_first101");
    if (!data) return;
    const ScratchFolder scratch("recording");
    const fs::path set = scratch.path() / "set", thinned = scratch.path() / "thinned";
    const std::string lidar = " --set odometry.source=lidar --max-scans 30 ";
    const ProgramResult recorded =
        good(scratch, "odometry " + quoted(*data) + lidar + "--set keyframes.distance=1 --out " + quoted(set));
    CHECK(contains(recorded.output, "scans        30 (0 lost"));
    CHECK(contains(recorded.output, "recorded     " + set.string()));
    CHECK(fs::is_regular_file(set / "config.toml"));
    const nlohmann::json description = nlohmann::json::parse(read_text(set / "odometry.json"));
    CHECK(description["frames"] == 30);
    CHECK(description["keyframes"]["distance"] == 1);
    const nlohmann::json summary = summary_of(set);
    CHECK(summary["stages"]["odometry"]["count"] == 30);
    CHECK(summary["errors"]["odometry"]["ape"]["poses"] == 30);
    CHECK(summary["peak_memory_bytes"].get<double>() > 1e6);

    const std::string found = good(scratch, "inspect " + quoted(set)).output;
    CHECK(contains(found, "odometry lidar"));
    CHECK(contains(found, "30 frames of 30 scans, 0 of them lost"));

    good(scratch, "map " + quoted(set) + " --set keyframes.distance=5 --out " + quoted(thinned));
    const auto kept = summary_of(thinned)["keyframes"].get<int>();
    CHECK(kept > 2);
    CHECK(3 * kept <= static_cast<int>(std::distance(fs::directory_iterator(set / "Scans"), fs::directory_iterator())));

    const ProgramResult again =
        run_program(scratch.path(), "odometry " + quoted(set) + " --out " + quoted(scratch.path() / "b"));
    CHECK(again.exit_code == 3);
    CHECK(contains(again.errors, "do: map it"));
    const ProgramResult over =
        run_program(scratch.path(), "odometry " + quoted(*data) + lidar + "--out " + quoted(set));
    CHECK(over.exit_code == 4);
    CHECK(nlohmann::json::parse(read_text(set / "odometry.json")) == description);
  }
}
