#include <doctest/doctest.h>

#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <string>

#include "chainslam/io/trajectory_file.hpp"
#include "chainslam/trajectory/pose_errors.hpp"
#include "support/real_data.hpp"

// The expected values are evo's own: the stats.json of its published test results, and those in the data's README.

using namespace chainslam;

namespace {

/// The number of a key in evo's flat stats.json.
double json_number(const std::filesystem::path& path, const std::string& key) {
  std::ifstream file(path);
  const std::string text(std::istreambuf_iterator<char>(file), {});
  const auto at = text.find('"' + key + "\":");
  REQUIRE_MESSAGE(at != std::string::npos, path.string() << " has no key " << key);
  return std::strtod(text.c_str() + at + key.size() + 3, nullptr);
}

void check_against(const ErrorStatistics& ours, const std::filesystem::path& stats) {
  // evo works on the files' matrices as they are, which are rotations to their six to nine digits only; ours are made
  // exact. Sums over 4541 poses are compared relatively.
  CHECK(std::abs(ours.rmse - json_number(stats, "rmse")) < 1e-6);
  CHECK(std::abs(ours.mean - json_number(stats, "mean")) < 1e-6);
  CHECK(std::abs(ours.median - json_number(stats, "median")) < 1e-6);
  CHECK(std::abs(ours.std - json_number(stats, "std")) < 1e-6);
  CHECK(std::abs(ours.min - json_number(stats, "min")) < 1e-6);
  CHECK(std::abs(ours.max - json_number(stats, "max")) < 1e-6);
  CHECK(ours.sse == doctest::Approx(json_number(stats, "sse")).epsilon(1e-6));
}

struct Case {
  const char* file;
  const char* name;
  double unaligned_rmse;
};
constexpr Case cases[] = {{"KITTI_00_ORB.txt", "orb", 7.790289}, {"KITTI_00_SPTAM.txt", "sptam", 9.224542}};

}  // namespace

TEST_SUITE("evaluation/evo") {
  TEST_CASE("absolute and relative errors of KITTI 00 are evo's") {
    for (const Case& published : cases) {
      CAPTURE(published.name);
      const auto folder = test::real_data("trajectories/evo");
      if (!folder) return;
      const Trajectory reference = read_kitti_poses(*folder / "KITTI_00_gt.txt");
      const Trajectory estimate = read_kitti_poses(*folder / published.file);
      REQUIRE(reference.size() == 4541);

      const auto aligned = ape(reference, estimate, {.align = Alignment::se3});
      check_against(aligned.translation, *folder / (std::string(published.name) + "_ape") / "stats.json");
      const auto unaligned = ape(reference, estimate, {.align = Alignment::none});
      CHECK(std::abs(unaligned.translation.rmse - published.unaligned_rmse) < 1e-6);
      const auto relative = rpe(reference, estimate, {.delta = 10, .unit = DeltaUnit::metres});
      check_against(relative.translation, *folder / (std::string(published.name) + "_rpe") / "stats.json");
      std::printf("FIGURE %s on KITTI 00: APE rmse %.6f m (evo %.6f), RPE 10 m rmse %.6f m (evo %.6f)\n",
                  published.name, aligned.translation.rmse,
                  json_number(*folder / (std::string(published.name) + "_ape") / "stats.json", "rmse"),
                  relative.translation.rmse,
                  json_number(*folder / (std::string(published.name) + "_rpe") / "stats.json", "rmse"));
    }
  }
}
