#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <string>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/random.hpp"
#include "chainslam/features/normals.hpp"
#include "chainslam/io/map_archive.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "chainslam/lie/umeyama.hpp"
#include "chainslam/registration/icp.hpp"
#include "chainslam/search/indexed_cloud.hpp"
#include "chainslam/search/kd_tree.hpp"
#include "program/run_program.hpp"
#include "program/sessions.hpp"
#include "support/real_data.hpp"

#include <doctest/doctest.h>

namespace {

using namespace chainslam;
using namespace chainslam::test;

nlohmann::json mapped(const ScratchFolder& scratch, const std::string& data, const fs::path& out,
                      const std::string& options = "") {
  const ProgramResult result = run_program(scratch.path(), "map " + data + " --out " + quoted(out) + " " + options);
  CAPTURE(result.errors);
  CAPTURE(result.output);
  REQUIRE(result.exit_code == 0);
  return summary_of(out);
}

Index accepted(const nlohmann::json& summary, const char* kind) { return summary["closures"][kind].get<Index>(); }

/// Three simulated drives through one town, mapped into one; in the longest runs once more without chaining, and once
/// more on one thread.
void map_town(unsigned seed) {
  CAPTURE(seed);
  const ScratchFolder scratch("town_sessions");
  const fs::path town = scratch.path() / "town";
  const ProgramResult simulated =
      run_program(scratch.path(), "simulate town-sessions --seed " + std::to_string(seed) + " --out " + quoted(town));
  REQUIRE(simulated.exit_code == 0);
  std::string data;
  for (const char* session : {"session1", "session2", "session3"}) data += quoted(town / session) + " ";
  const std::string options = "--set odometry.map_radius=30 --set goals.merged=true";
  const fs::path out = scratch.path() / "chained";
  const nlohmann::json chained = mapped(scratch, data, out, options);
  const nlohmann::json& cost = chained["back_end"];
  std::printf(
      "FIGURE town, seed %u: APE front end alone %.3f m, chained %.3f m; between sessions %.4f m; %d chained "
      "closures\n",
      seed, rmse(chained, "odometry"), rmse(chained, "optimized"), rmse(chained, "inter_session", "rpe"),
      accepted(chained, "chained"));
  std::printf("FIGURE town, seed %u: back end per keyframe %s; peak memory %.0f MB\n", seed,
              cost["per_keyframe"].dump().c_str(), chained["peak_memory_bytes"].get<double>() / 1e6);
  CHECK(accepted(chained, "chained") >= 30);
  CHECK(rmse(chained, "optimized") < 0.5 * rmse(chained, "odometry"));
  // Of seeds 1 to 5 0.026 to 0.068 m and 7 to 10 mm when written.
  CHECK(rmse(chained, "optimized") < 0.1);
  CHECK(rmse(chained, "inter_session", "rpe") < 0.02);
  if (!full()) return;

  const nlohmann::json unchained =
      mapped(scratch, data, scratch.path() / "unchained", options + " --set chain.enabled=false");
  std::printf("FIGURE town, seed %u: unchained APE %.3f m, between sessions %.4f m\n", seed,
              rmse(unchained, "optimized"), rmse(unchained, "inter_session", "rpe"));
  CHECK(accepted(unchained, "chained") == 0);
  CHECK(rmse(chained, "inter_session", "rpe") <= 1.1 * rmse(unchained, "inter_session", "rpe"));

  if (seed != 1) return;
  const fs::path again = scratch.path() / "again";
  mapped(scratch, data, again, options + " --threads 1");
  CHECK_MESSAGE(read_text(out / "map.cslam") == read_text(again / "map.cslam"), "the same map, whatever the threads");
}

/// A walk's folder with fixes beside it: the reference's positions and a metre of noise.
void add_fixes(const fs::path& source, const fs::path& folder, const SE3d& T_reference, Rng& rng) {
  fs::create_directories(folder);
  for (const char* name : {"Scans", "odom_poses.txt", "times.txt"}) fs::create_symlink(source / name, folder / name);
  constexpr double latitude = 22.2831, longitude = 114.1366, metres_per_degree = 111195;
  std::string text;
  for (const SE3d& pose : read_kitti_poses(source / "optimized_poses.txt").poses) {
    const Eigen::Vector3d p =
        T_reference * pose.translation() + Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal());
    char line[128];
    std::snprintf(line, sizeof line, "%.9f %.9f %.3f 1.0\n", latitude + p.y() / metres_per_degree,
                  longitude + p.x() / (metres_per_degree * std::cos(latitude * std::numbers::pi / 180)), p.z());
    text += line;
  }
  write_text(folder / "gnss.txt", text);
}

PointCloud<float> points_of(const SlamMap& map, std::size_t session) {
  PointCloud<float> points;
  for (const Keyframe& keyframe : map.keyframes) {
    if (keyframe.session.value != static_cast<Index>(session)) continue;
    const PointCloud<float> seen = transformed(*keyframe.cloud.load(), keyframe.T_map_body);
    points.positions.insert(points.positions.end(), seen.positions.begin(), seen.positions.end());
  }
  return voxel_downsample(points, 0.1);
}

/// How far one session's points have to be moved to lie best on the other's.
SE3d misalignment(const SlamMap& map) {
  PointCloud<float> first = points_of(map, 0);
  estimate_normals(first, NormalOptions{.neighbors = 12, .radius = 1.0}, Eigen::Vector3d::Zero(), Serial{});
  const IndexedCloud<> target(std::move(first));
  const Icp<PointToPlane, GemanMcClure> icp{.max_iterations = 100, .max_distance = 0.5, .kernel = {.width = 0.2}};
  return icp.align(points_of(map, 1), target, SE3d()).T_target_source;
}

/// Mean distance, metres, from one session's points to the other's nearest, where both have seen something.
double thickness(const SlamMap& map) {
  const PointCloud<float> first = points_of(map, 0), second = points_of(map, 1);
  const KdTree<> tree(first);
  double sum = 0, count = 0;
  for (const Eigen::Vector3f& point : second.positions) {
    Neighbor<float> nearest;
    if (tree.knn(point, std::span(&nearest, 1), 1.0F) == 0) continue;
    sum += std::sqrt(static_cast<double>(nearest.squared_distance));
    ++count;
  }
  return sum / count;
}

}  // namespace

TEST_SUITE("program/sessions") {
  TEST_CASE("three drives through the embedded town become one map" * doctest::skip(quick())) {
    const unsigned seeds = full() ? 5 : 1;
    for (unsigned seed = 1; seed <= seeds; ++seed) map_town(seed);
  }

  TEST_CASE("hku_square_two_sessions: the second walk is merged with the saved map of the first" *
            doctest::skip(quick())) {
    const auto data = real_data("hku_square_two_sessions");
    if (!data) return;
    const ScratchFolder scratch("hku_sessions");
    const fs::path first = scratch.path() / "session1", second = scratch.path() / "session2";
    const SE3d T_1_2 = read_matrix(*data / "T_session1_session2.txt");
    Rng rng(1);
    add_fixes(*data / "session1", first, SE3d(), rng);
    add_fixes(*data / "session2", second, T_1_2, rng);
    mapped(scratch, quoted(first), scratch.path() / "map1");
    const std::string load = "--load " + quoted(scratch.path() / "map1") + " --set goals.merged=true";
    const nlohmann::json summary = mapped(scratch, quoted(second), scratch.path() / "chained", load);
    mapped(scratch, quoted(second), scratch.path() / "unchained", load + " --set chain.enabled=false");
    CHECK(accepted(summary, "chained") > 0);

    const SlamMap map = load_map(scratch.path() / "chained" / "map.cslam").map;
    REQUIRE(map.sessions.size() == 2);
    const SE3d T_map_1 = fitted(map, 0, read_kitti_poses(*data / "session1" / "optimized_poses.txt").poses);
    const SE3d T_map_2 = fitted(map, 1, read_kitti_poses(*data / "session2" / "optimized_poses.txt").poses);
    const SE3d error = T_1_2.inverse() * T_map_1.inverse() * T_map_2;
    const SE3d between = misalignment(map);
    const SlamMap unchained = load_map(scratch.path() / "unchained" / "map.cslam").map;
    std::printf(
        "FIGURE hku, session 2 on session 1: T_1_2 off by %.3f m, %.2f deg; maps off by %.3f m, %.2f deg, %.4f m "
        "apart chained, %.4f m unchained; %d chained closures; back end per keyframe %s\n",
        error.translation().norm(), in_degrees(error), between.translation().norm(), in_degrees(between),
        thickness(map), thickness(unchained), accepted(summary, "chained"),
        summary["back_end"]["per_keyframe"].dump().c_str());
    // The reference lies between maps that the recorder's poses bend by 0.1 m: with ours the same points fit more
    // sharply. So it is a loose bound, and that the two sessions' own points lie on each other is the tight one.
    CHECK(error.translation().norm() < 0.2);
    CHECK(in_degrees(error) < 1.0);
    CHECK(between.translation().norm() < 0.05);
    CHECK(in_degrees(between) < 0.2);
  }
}
