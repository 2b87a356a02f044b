#include <cmath>
#include <cstdio>
#include <functional>
#include <regex>
#include <string>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/io/map_archive.hpp"
#include "chainslam/io/pcd.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "program/faults.hpp"
#include "program/run_program.hpp"

#include <doctest/doctest.h>

namespace {

using namespace chainslam;
using namespace chainslam::test;

/// Points on the walls and the floor of a corridor, 15 m to either side along x.
PointCloud<float> walls(Rng& rng) {
  PointCloud<float> cloud;
  for (int i = 0; i < 120; ++i)
    cloud.positions.emplace_back(static_cast<float>(rng.uniform(-15, 15)), i % 2 == 0 ? 2.0F : -2.0F,
                                 static_cast<float>(rng.uniform(-1, 2)));
  return cloud;
}

/// A data set of keyframes `step` metres apart along x, one a second, from `start` on.
/// @param cloud  of each keyframe.
void write_line(const fs::path& folder, int count, double step, const Eigen::Vector3d& start,
                const std::function<PointCloud<float>()>& cloud) {
  fs::create_directories(folder / "Scans");
  Trajectory odometry;
  std::string times;
  for (int i = 0; i < count; ++i) {
    odometry.poses.emplace_back(SO3d(), start + Eigen::Vector3d(step * i, 0, 0));
    char name[32];
    std::snprintf(name, sizeof name, "%06d.pcd", i);
    write_pcd(folder / "Scans" / name, cloud());
    times += std::to_string(i + 1) + "\n";
  }
  write_kitti_poses(folder / "odom_poses.txt", odometry);
  write_text(folder / "times.txt", times);
}

/// Maps the data set in `root`/data, exports the map, and checks all that comes of it. @returns the map.
SlamMap check_run(const fs::path& root, int keyframes) {
  const fs::path out = root / "out";
  const ProgramResult result = run_program(root, "map " + quoted(root / "data") + " --out " + quoted(out));
  CAPTURE(result.errors);
  REQUIRE(result.exit_code == 0);
  for (const char* name : {"map.cslam", "report.html", "map.png", "map.ply", "trajectory.tum", "graph.g2o"})
    CHECK_MESSAGE(fs::file_size(out / name) > 20, name);
  CHECK(read_text(out / "map.png").substr(0, 4) == "\x89PNG");
  CHECK(contains(read_text(out / "report.html"), "Map from above"));
  for (const char* name :
       {"trajectory.tum", "keyframes.csv", "closures.csv", "frames.csv", "graph.g2o", "summary.json"})
    for (const char* wrong : {"nan", "inf,", "inf "}) CHECK_MESSAGE(!contains(read_text(out / name), wrong), name);
  CHECK(summary_of(out)["keyframes"] == keyframes);
  for (const char* format : {"ply", "pcd"}) {
    const fs::path cloud = root / (std::string("cloud.") + format);
    CHECK(run_program(root, "export " + quoted(out / "map.cslam") + " --format " + format + " --out " + quoted(cloud))
              .exit_code == 0);
    fs::remove(cloud);
  }
  SlamMap map = load_map(out / "map.cslam").map;
  fs::remove_all(out);
  return map;
}

}  // namespace

TEST_SUITE("program/extreme runs") {
  TEST_CASE("corridors of 1, 4, 15 and 100 km are mapped, with report and picture") {
    for (const double km : {1.0, 4.0, 15.0, 100.0}) {
      if (!full() && km != 4.0 && km != 100.0) continue;
      CAPTURE(km);
      const ScratchFolder scratch("corridor");
      Rng rng(1);
      const int count = full() ? std::min(2000, static_cast<int>(500 * km)) : 150;
      write_line(scratch.path() / "data", count, 1000 * km / (count - 1), Eigen::Vector3d::Zero(),
                 [&] { return walls(rng); });
      const SlamMap map = check_run(scratch.path(), count);
      CHECK(map.keyframes.back().T_map_body.translation().x() == doctest::Approx(1000 * km).epsilon(1e-3));
    }
  }

  TEST_CASE("one point, all points in one place, and places 1e8 m from the origin") {
    const auto point = [](int copies) {
      PointCloud<float> cloud;
      cloud.positions.assign(static_cast<std::size_t>(copies), Eigen::Vector3f(1, 2, 3));
      return cloud;
    };
    Rng rng(2);
    const Eigen::Vector3d origin = Eigen::Vector3d::Zero();
    struct Case {
      int count;
      double step;
      Eigen::Vector3d start;
      std::function<PointCloud<float>()> cloud;
    };
    const std::vector<Case> cases{{1, 0, origin, [&] { return point(1); }},
                                  {30, 0, origin, [&] { return point(500); }},
                                  {30, 0, origin, [&] { return walls(rng); }},
                                  {40, 1, {1e8, -1e8, 1e8}, [&] { return walls(rng); }}};
    for (const Case& one : cases) {
      CAPTURE(one.count);
      CAPTURE(one.start.x());
      const ScratchFolder scratch("extreme");
      write_line(scratch.path() / "data", one.count, one.step, one.start, one.cloud);
      const SlamMap map = check_run(scratch.path(), one.count);
      const Eigen::Vector3d moved =
          map.keyframes.back().T_map_body.translation() - map.keyframes.front().T_map_body.translation();
      CHECK((moved - Eigen::Vector3d(one.step * (one.count - 1), 0, 0)).norm() < 1);
    }
  }

  TEST_CASE("poses that cannot be are left out and counted, and leave no number that is not finite") {
    for (const double far : {1e20, 1e200, -1e308}) {
      CAPTURE(far);
      const ScratchFolder scratch("out_of_range");
      const fs::path root = scratch.path(), out = root / "out";
      Rng rng(3);
      write_line(root / "data", 12, 1, Eigen::Vector3d::Zero(), [&] { return walls(rng); });
      std::vector<std::string> rows(12);
      for (int i = 0; i < 12; ++i)
        rows[static_cast<std::size_t>(i)] = "1 0 0 " + std::to_string(i) + " 0 1 0 0 0 0 1 0";
      char row[1200];
      std::snprintf(row, sizeof row, "1 0 0 %g 0 1 0 %g 0 0 1 0", far, -far);
      rows[5] = row;
      std::string text;
      for (const std::string& one : rows) text += one + "\n";
      write_text(root / "data/odom_poses.txt", text);
      const ProgramResult result = run_program(root, "map " + quoted(root / "data") + " --out " + quoted(out));
      CAPTURE(result.errors);
      REQUIRE(result.exit_code == 0);
      CHECK(contains(result.errors, "1 frames left out: their poses are more than 1e9 m from the origin"));
      const auto summary = summary_of(out);
      CHECK(summary["keyframes"] == 11);
      CHECK(summary["path_length_m"].get<double>() < 100);
      const std::regex wrong("[, ]-?(nan|inf)\\b|:null");
      for (const auto& entry : fs::directory_iterator(out))
        if (entry.path().extension() != ".html" && entry.path().extension() != ".cslam")
          CHECK_MESSAGE(!std::regex_search(read_text(entry.path()), wrong), entry.path().filename().string());
    }
  }
}
