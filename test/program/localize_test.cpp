#include <doctest/doctest.h>

#include <cmath>
#include <cstddef>
#include <sstream>
#include <string>
#include <vector>

#include "chainslam/io/map_archive.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "program/keyframe_data.hpp"
#include "program/run_program.hpp"

// `localize`: a drive is found in the map of another one, and followed; the map stays as it is.

namespace {

using namespace chainslam;
using namespace chainslam::test;

constexpr int scans_of_a_drive = 36;
const std::string small_places = " --set localize.place_length=20 --set localize.place_spacing=5";

/// A map of one and a third rounds of a circle, and a drive along the same way whose odometry errs differently.
class MappedRound {
 public:
  MappedRound() : scratch_("localize") {
    write_keyframes(path("first"), scans_of_a_drive);
    write_keyframes(path("second"), scans_of_a_drive, false, 9);
    const ProgramResult result =
        run_program(scratch_.path(), "map " + quoted(path("first")) + " --out " + quoted(path("map")) +
                                         " --set closures.min_keyframes=0");  // the round is short
    CAPTURE(result.errors);
    REQUIRE(result.exit_code == 0);
  }
  [[nodiscard]] fs::path path(const std::string& name) const { return scratch_.path() / name; }
  [[nodiscard]] ProgramResult localize(const std::string& arguments) const {
    return run_program(scratch_.path(), "localize " + quoted(path("second")) + " --load " + quoted(path("map")) +
                                            " --out " + quoted(path("out")) + small_places + arguments);
  }

 private:
  ScratchFolder scratch_;
};

std::vector<std::vector<std::string>> rows_of(const fs::path& table) {
  std::vector<std::vector<std::string>> rows;
  std::istringstream lines(read_text(table));
  for (std::string line; std::getline(lines, line);) {
    rows.emplace_back();
    for (std::size_t at = 0; at <= line.size();) {
      const std::size_t end = std::min(line.find(',', at), line.size());
      rows.back().push_back(line.substr(at, end - at));
      at = end + 1;
    }
  }
  return rows;
}

}  // namespace

TEST_SUITE("program/localize") {
  TEST_CASE("a drive is found in a saved map and followed there, and the map is not changed") {
    const MappedRound round;
    const std::string map = read_text(round.path("map") / "map.cslam");
    const ProgramResult result = round.localize("");
    CAPTURE(result.output);
    CAPTURE(result.errors);
    REQUIRE(result.exit_code == 0);
    CHECK(contains(result.output, "found        after "));
    CHECK(read_text(round.path("map") / "map.cslam") == map);

    const auto summary = summary_of(round.path("out"));
    CHECK(summary["frames"] == scans_of_a_drive);
    CHECK(summary["cold_starts"] == 1);
    CHECK(summary["lost_share"] == 0.0);
    CHECK(summary["seconds_to_first_fix"].get<double>() <= 15 * 1.5);

    const LoadedMap loaded = load_map(round.path("map") / "map.cslam");
    const auto rows = rows_of(round.path("out") / "localization.csv");
    REQUIRE(rows.size() == scans_of_a_drive + 1);
    Index poses = 0;
    for (std::size_t i = 1; i < rows.size(); ++i) {
      REQUIRE(rows[i].size() == rows[0].size());
      const bool has_pose = rows[i][1] == "tracking" || rows[i][1] == "uncertain";
      CHECK(rows[i][5].empty() == !has_pose);
      if (!has_pose) continue;
      ++poses;
      const Keyframe& there = loaded.map.keyframes[i - 1];  // both drives were at the same places
      CHECK(std::abs(std::stod(rows[i][5]) - there.T_map_body.translation().x()) < 0.2);
      CHECK(std::abs(std::stod(rows[i][6]) - there.T_map_body.translation().y()) < 0.2);
      CHECK(std::stod(rows[i][12]) > 0);  // the variance along x
    }
    CHECK(poses >= 20);
    CHECK(poses == to_index(read_tum(round.path("out") / "localization.tum").size()));
    CHECK(poses == summary["tracked"].get<Index>() + summary["uncertain"].get<Index>());
  }

  TEST_CASE("an earlier result is kept; without enough of a path nothing is found, which is exit code 5") {
    const MappedRound round;
    const ProgramResult result = round.localize(" --max-scans 2");
    CAPTURE(result.errors);
    CHECK(result.exit_code == 5);
    CHECK(contains(result.output, "not found"));
    CHECK(summary_of(round.path("out"))["seconds_to_first_fix"].is_null());
    CHECK(read_text(round.path("out") / "localization.tum").find("1") == std::string::npos);
    CHECK(round.localize("").exit_code == 4);
    CHECK(round.localize(" --max-scans 2 --overwrite").exit_code == 5);
    CHECK(fs::exists(round.path("out~1") / "summary.json"));
  }
}
