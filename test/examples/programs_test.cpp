#include <doctest/doctest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/io/g2o.hpp"
#include "chainslam/io/map_archive.hpp"
#include "chainslam/io/pcd.hpp"
#include "chainslam/io/ply.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "generated/arc_fixes.hpp"
#include "generated/beacon_drive.hpp"
#include "generated/circle_drive.hpp"
#include "generated/circle_edges.hpp"
#include "generated/growing_map.hpp"
#include "generated/hall_drive.hpp"

// The example programs, run without arguments and with files, as a user runs them.

namespace chainslam::test {
namespace {

namespace fs = std::filesystem;

/// An empty folder of its own, removed at the end.
class Folder {
 public:
  Folder() : path_(fs::temp_directory_path() / ("chainslam_examples_" + std::to_string(::getpid()))) {
    fs::remove_all(path_);
    fs::create_directories(path_);
  }
  ~Folder() {
    std::error_code ignored;
    fs::remove_all(path_, ignored);
  }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;

  [[nodiscard]] std::string operator/(const std::string& name) const { return (path_ / name).string(); }

 private:
  fs::path path_;
};

std::string content_of(const std::string& name) {
  std::ifstream file(name, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

struct Outcome {
  int exit_code = -1;
  std::string output, errors;

  /// The number after `before`, the first of that name behind `after`; NaN if there is none.
  [[nodiscard]] double number(const std::string& before, const std::string& after = "") const {
    const std::size_t from = output.find(after);
    const std::size_t at = from == std::string::npos ? from : output.find(before, from);
    if (at == std::string::npos) return std::nan("");
    char* end = nullptr;
    const char* begin = output.c_str() + at + before.size();
    const double value = std::strtod(begin, &end);
    return end == begin ? std::nan("") : value;
  }
  [[nodiscard]] bool says(const std::string& text) const { return output.find(text) != std::string::npos; }
};

/// Runs example_NAME with arguments.
Outcome run(const Folder& folder, const std::string& name, const std::vector<std::string>& arguments = {}) {
  std::string command = "'" CHAINSLAM_EXAMPLES "/example_" + name + "'";
  for (const std::string& argument : arguments) command += " '" + argument + "'";
  const std::string output = folder / "stdout.txt", errors = folder / "stderr.txt";
  const int status = std::system((command + " >'" + output + "' 2>'" + errors + "'").c_str());
  Outcome outcome{WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status), content_of(output),
                  content_of(errors)};
  INFO(name, ":\n", outcome.output, outcome.errors);
  CHECK(outcome.errors.empty() == (outcome.exit_code != 2));
  return outcome;
}

/// The same, of which success is expected.
Outcome succeed(const Folder& folder, const std::string& name, const std::vector<std::string>& arguments = {}) {
  Outcome outcome = run(folder, name, arguments);
  CHECK_MESSAGE(outcome.exit_code == 0, name, ":\n", outcome.output, outcome.errors);
  return outcome;
}

/// A cloud of the hall in a file, seen from a place.
std::string hall_file(const Folder& folder, const std::string& name, const SE3d& T_hall_lidar, std::uint64_t seed) {
  Rng rng(seed);
  const PointCloud<float> cloud = generated::scan(T_hall_lidar, rng);
  if (name.ends_with(".ply"))
    write_ply(folder / name, cloud);
  else
    write_pcd(folder / name, cloud);
  return folder / name;
}

}  // namespace

TEST_SUITE("examples/programs") {
  TEST_CASE("icp_of_two_files: all metrics find the motion between two scans") {
    const Folder folder;
    const Outcome made_up = succeed(folder, "icp_of_two_files");
    CHECK(made_up.number("error ") < 0.01);
    for (const char* metric : {"point to plane", "own kernel", "gicp"}) {
      CHECK(made_up.number("t = ", metric) == doctest::Approx(0.5).epsilon(0.05));
      CHECK(made_up.number("overlap ", metric) > 0.9);
    }
    const Outcome of_files = succeed(folder, "icp_of_two_files",
                                     {hall_file(folder, "a.pcd", generated::upright(5.2, -2, 0.05), 5),
                                      hall_file(folder, "b.ply", generated::upright(5, -2, 0), 6)});
    CHECK(of_files.number("t = ", "gicp") == doctest::Approx(0.2).epsilon(0.05));
    CHECK(run(folder, "icp_of_two_files", {folder / "a.pcd", folder / "c.xyz"}).errors.find("'.xyz'") !=
          std::string::npos);
  }

  TEST_CASE("search_trees: figures agree with a look at every point") {
    const Folder folder;
    const auto check = [](const Outcome& outcome, const PointCloud<float>& cloud) {
      const Eigen::Vector3f query = cloud.positions[cloud.size() / 2];
      int near = 0;
      for (const Eigen::Vector3f& p : cloud.positions) near += (p - query).norm() <= 0.5f ? 1 : 0;
      CHECK(outcome.number("k-d tree ") == static_cast<double>(cloud.size()));

      CHECK(outcome.says("           " + std::to_string(near) + " points within 0.5 m"));
      CHECK(outcome.says("taken, found as scan 2"));
      CHECK(outcome.number("erased ") == 1);
      CHECK(outcome.number("ikd-tree ") > outcome.number("8 m: "));
      CHECK(outcome.number("ikd-tree ") ==
            outcome.number("in a box and ") + outcome.number("8 m: "));  // one was added, and erased again
    };
    Rng rng(1);
    check(succeed(folder, "search_trees"), generated::scan(generated::upright(0, 3, 0), rng));
    const std::string file = hall_file(folder, "a.pcd", generated::upright(-4, 1, 1), 9);
    check(succeed(folder, "search_trees", {file}), read_pcd(file));
  }

  TEST_CASE("own_filter: speed and turn rate are found within what the filter states") {
    const Folder folder;
    const Outcome made_up = succeed(folder, "own_filter");
    CHECK(std::abs(made_up.number("speed ") - 5) < 3 * made_up.number("+- ", "speed"));
    CHECK(std::abs(made_up.number("turn rate ") - 0.25) < 3 * made_up.number("+- ", "turn rate"));
    CHECK(made_up.number("nis ") > 0.5);
    CHECK(made_up.number("nis ") < 1.2);
    write_tum(folder / "fixes.tum", generated::arc_fixes(2.0, -0.1, 0.05));
    const Outcome of_file = succeed(folder, "own_filter", {folder / "fixes.tum"});
    CHECK(std::abs(of_file.number("speed ") - 2) < 3 * of_file.number("+- ", "speed"));
    CHECK(of_file.number("turn rate ") < -0.02);
  }

  TEST_CASE("odometry_of_packets: the drive is followed, and files give what the packets gave") {
    const Folder folder;
    const Outcome made_up = succeed(folder, "odometry_of_packets");
    CHECK(made_up.number("# frames ") == 80);
    CHECK(made_up.number("lost ") == 0);
    CHECK(made_up.number("# error ") < 0.05);
    std::vector<std::string> arguments{folder / "imu.txt"};
    const auto hundredths = [](Timestamp time) {  // of a second, exact: the generated times are multiples of it
      const std::string digits = std::to_string(1000 + time.nanoseconds() / 10'000'000);
      return std::to_string(time.nanoseconds() / 1'000'000'000) + "." + digits.substr(digits.size() - 2);
    };
    std::ofstream imu(folder / "imu.txt");
    imu.precision(17);
    for (const Packet& packet : generated::circle_drive()) {
      if (const auto* sample = std::get_if<ImuSample>(&packet))
        imu << hundredths(sample->time) << ' ' << sample->gyro.transpose() << ' ' << sample->accel.transpose() << '\n';
      const auto* scan = std::get_if<LidarScan>(&packet);
      if (scan == nullptr || arguments.size() > 20) continue;
      arguments.push_back(folder / (hundredths(scan->time) + ".pcd"));
      write_pcd(arguments.back(), scan->cloud);
    }
    imu.close();
    const Outcome of_files = succeed(folder, "odometry_of_packets", arguments);
    CHECK(of_files.number("# frames ") == 20);
    const auto line = [](const Outcome& outcome, int number) {
      std::size_t at = 0;
      for (int i = 0; i < number; ++i) at = outcome.output.find('\n', at) + 1;
      return outcome.output.substr(at, outcome.output.find('\n', at) - at);
    };
    CHECK(line(of_files, 15) == line(made_up, 15));
  }

  TEST_CASE("pose_graph_with_own_factor: the beacon is found, and distances join vertices of a file") {
    const Folder folder;
    const Outcome made_up = succeed(folder, "pose_graph_with_own_factor");
    CHECK(std::abs(made_up.number("beacon ") - 20) < 3 * made_up.number("+- ", "beacon"));
    CHECK(made_up.number("+- ", "beacon") < 1);
    CHECK(made_up.number("-> ") < 60);  // chi^2 of 30 degrees of freedom, 99.9 %
    G2oFile file;
    file.planar = generated::beacon_drive();
    write_g2o(folder / "graph.g2o", file);
    CHECK(succeed(folder, "pose_graph_with_own_factor", {folder / "graph.g2o"}).number("-> ") < 1e-9);
    const double ends = (generated::arc_pose(60).translation() - generated::arc_pose(0).translation()).norm();
    const Outcome of_file =
        succeed(folder, "pose_graph_with_own_factor", {folder / "graph.g2o", "0", "60", std::to_string(ends - 1)});
    CHECK(of_file.says("of them 1 distances"));
    CHECK(of_file.number("-> ") > 0.01);
  }

  TEST_CASE("incremental_smoother: the loop makes the end certain") {
    const Folder folder;
    const auto check = [](const Outcome& outcome) {
      CHECK(outcome.number("its end ") > 1.0);
      CHECK(outcome.number("-> ") < 0.05);
      CHECK(outcome.number("poses ") == 200);
      CHECK(outcome.number("factors ", "poses") == 201);
      CHECK(outcome.number("-> ", "cost") < 22.5);  // chi^2 of 6 degrees of freedom, 99.9 %
      CHECK(outcome.number("middle, ") < outcome.number("sigma      "));
    };
    check(succeed(folder, "incremental_smoother"));
    G2oFile file;
    file.spatial.edges = generated::circle_edges();
    write_g2o(folder / "graph.g2o", file);
    check(succeed(folder, "incremental_smoother", {folder / "graph.g2o"}));
  }

  TEST_CASE("global_registration: finds scans 7 m and 143 degrees apart, and refuses what is not there") {
    const Folder folder;
    const Outcome made_up = succeed(folder, "global_registration");
    CHECK(made_up.says("found "));
    CHECK(made_up.number("error ") < 0.05);
    const std::string a = hall_file(folder, "a.pcd", generated::upright(-6, -5, 1), 3);
    const Outcome of_files =
        succeed(folder, "global_registration", {a, hall_file(folder, "b.ply", generated::upright(0, -6, -2), 4)});
    CHECK(of_files.number("w = ") == doctest::Approx(0).epsilon(0.01));
    PointCloud<float> ball;
    for (int i = 0; i < 2000; ++i) {
      const double z = -1 + i / 1000.0, angle = 2.4 * i;
      ball.positions.push_back(
          (5 * Eigen::Vector3d(std::sqrt(1 - z * z) * std::cos(angle), std::sqrt(1 - z * z) * std::sin(angle), z))
              .cast<float>());
    }
    write_ply(folder / "ball.ply", ball);
    CHECK(run(folder, "global_registration", {a, folder / "ball.ply"}).exit_code == 1);
  }

  TEST_CASE("map_file: what a crash leaves is refused, recovered and saved") {
    const Folder folder;
    const Outcome made_up = succeed(folder, "map_file");
    CHECK(made_up.number("written ") == 10);
    CHECK(made_up.says("refused "));
    CHECK(made_up.says("a chunk's header that was cut short"));
    CHECK(made_up.number("recovered ") == 5);  // the sixth keyframe's commit is torn
    CHECK(made_up.number("saved ") == 5);
    SlamMap map;
    Rng rng(1);
    for (int i = 0; i < 3; ++i) generated::grow(map, rng);
    save_map(folder / "map.cslam", map);
    CHECK(succeed(folder, "map_file", {folder / "map.cslam", folder / "copy.cslam"}).number("read ") == 3);
    CHECK(load_map(folder / "copy.cslam").map.keyframes.size() == 3);
    fs::resize_file(folder / "map.cslam", fs::file_size(folder / "map.cslam") - 1);
    CHECK(run(folder, "map_file", {folder / "map.cslam"}).exit_code == 1);
  }

  TEST_CASE("two_sessions: the second is merged into the first one's frame, and closures are chained") {
    const Folder folder;
    const Outcome made_up = succeed(folder, "two_sessions");
    CHECK(made_up.number("frame of session ", "session 2") == 1);
    CHECK(made_up.number("merges ") == 1);
    CHECK(made_up.number("closures ") >= 10);
    CHECK(made_up.number("direct, ") >= 10);
    CHECK(made_up.number("error ") < 0.2);  // each session's odometry is off by 0.2 m at its end
    for (const auto& [name, drive] : {std::pair("a.cslam", generated::hall_drive(2.0, 0.002, 1)),
                                      std::pair("b.cslam", generated::hall_drive(-3.5, -0.002, 2))}) {
      SlamMap map;
      map.sessions.push_back({.id = SessionId{0}, .name = name, .keyframes = 44, .frame = SessionId{0}});
      for (Keyframe keyframe : drive) {
        keyframe.id = KeyframeId{static_cast<Index>(map.keyframes.size())};
        keyframe.session = SessionId{0};
        map.keyframes.push_back(keyframe);
      }
      save_map(folder / name, map);
    }
    const Outcome of_files = succeed(folder, "two_sessions", {folder / "a.cslam", folder / "b.cslam"});
    CHECK(of_files.number("frame of session ", "session 2") == 1);
  }

  TEST_CASE("localize_in_map: a drive is found in a map and followed, and a map's own drive in its file") {
    const Folder folder;
    const Outcome made_up = succeed(folder, "localize_in_map");
    CHECK(made_up.number("at scan ") <= 12);
    CHECK(made_up.number("scans      44, ") >= 30);
    CHECK(made_up.number("lost ") == 0);
    CHECK(made_up.number("error ") < 0.2);  // the map's odometry is off by 0.2 m at its end
    CHECK(run(folder, "localize_in_map", {folder / "none.cslam", folder / "none.cslam"}).exit_code == 2);
  }

  TEST_CASE("evaluate_trajectory: a drift of 1 % is measured, and a file compares with itself") {
    const Folder folder;
    const Outcome made_up = succeed(folder, "evaluate_trajectory");
    CHECK(made_up.number(" estimated, ") == 301);
    CHECK(made_up.number("with scale ") == doctest::Approx(1 / 1.01).epsilon(1e-3));
    CHECK(made_up.number("rpe        rmse ") == doctest::Approx(0.1).epsilon(0.05));
    CHECK(made_up.number("kitti ") == doctest::Approx(1).epsilon(0.05));
    write_tum(folder / "a.tum", generated::arc_fixes(5.0, 0.1, 0.0));
    const Outcome of_files = succeed(folder, "evaluate_trajectory", {folder / "a.tum", folder / "a.tum"});
    CHECK(of_files.number("ape        rmse ") < 1e-9);
  }

  TEST_CASE("the first three programs run") {
    const Folder folder;
    CHECK(succeed(folder, "align_two_clouds").number("error ") < 1e-3);
    CHECK(succeed(folder, "home_made_candidates").number("closures, ") > 0);
    G2oFile file;
    file.planar = generated::beacon_drive();
    write_g2o(folder / "graph.g2o", file);
    const Outcome optimized = succeed(folder, "optimize_g2o", {folder / "graph.g2o", folder / "result.g2o"});
    CHECK(optimized.number("(chi2) ") < 1e-6);
    CHECK(read_g2o(folder / "result.g2o").planar.vertices.size() == 61);
    CHECK(run(folder, "optimize_g2o").exit_code == 2);
  }
}

}  // namespace chainslam::test
