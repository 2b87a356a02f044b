#include <doctest/doctest.h>

#include <algorithm>
#include <string>
#include <vector>

#include "chainslam/io/map_archive.hpp"
#include "program/keyframe_data.hpp"
#include "program/run_program.hpp"

// Settings of the back end, by what they do to a map.

namespace {

using namespace chainslam;
using namespace chainslam::test;

/// One and a third rounds of a circle of 20 m with a fix at each keyframe, mapped with some settings.
class RoundMap {
 public:
  RoundMap() : scratch_("back_end_settings") { write_keyframes(data(), 36, true); }

  [[nodiscard]] std::vector<SE3d> poses(const std::string& settings) const {
    const fs::path out = scratch_.path() / "out";
    fs::remove_all(out);
    std::string options;
    for (std::size_t at = 0; at < settings.size();) {
      const std::size_t end = std::min(settings.find(' ', at), settings.size());
      options += " --set " + settings.substr(at, end - at);
      at = end + 1;
    }
    const ProgramResult result =
        run_program(scratch_.path(), "map " + quoted(data()) + " --out " + quoted(out) + options);
    CAPTURE(result.errors);
    REQUIRE(result.exit_code == 0);
    const LoadedMap loaded = load_map(out / "map.cslam");
    std::vector<SE3d> poses;
    for (const Keyframe& keyframe : loaded.map.keyframes) poses.push_back(keyframe.T_map_body);
    REQUIRE(poses.size() == 36);
    return poses;
  }

 private:
  [[nodiscard]] fs::path data() const { return scratch_.path() / "data"; }

  ScratchFolder scratch_;
};

/// The largest distance of two maps' keyframes, metres.
double apart(const std::vector<SE3d>& a, const std::vector<SE3d>& b) {
  double most = 0;
  for (std::size_t i = 0; i < a.size(); ++i) most = std::max(most, (a[i].translation() - b[i].translation()).norm());
  return most;
}

}  // namespace

TEST_SUITE("program/back_end_settings") {
  TEST_CASE(
      "fixes hold a map where they spread far enough, and are many and good enough; the antenna may stand aside") {
    const RoundMap map;
    const std::string held = "graph.gnss_least_spread=10 graph.gnss_bias=0.1 graph.gnss_correlated=1";
    const std::vector<SE3d> without = map.poses("graph.gnss=false"), with = map.poses(held);
    CHECK(apart(map.poses(""), without) == 0);  // 14 m across are too few to say where the map lies
    CHECK(apart(with, without) > 0.01);
    CHECK(apart(map.poses(held + " graph.gnss_max_sigma=0.1"), without) == 0);
    CHECK(apart(map.poses(held + " graph.gnss_least_fixes=37"), without) == 0);
    CHECK(apart(map.poses(held + " graph.gnss_bias=10"), with) > 0.001);
    CHECK(apart(map.poses(held + " graph.gnss_correlated=100"), with) > 0.001);
    CHECK(apart(map.poses(held + " graph.gnss_antenna_y=3"), with) > 0.01);
  }

  TEST_CASE("a map does not depend on how many submaps are kept; their memory is stated in MiB") {
    const RoundMap map;
    CHECK(apart(map.poses("closures.submap_memory=1"), map.poses("")) == 0);
    const ScratchFolder scratch("submap_memory");
    CHECK(contains(run_program(scratch.path(), "config --print").output, "submap_memory = 512\n"));
    const ProgramResult none = run_program(scratch.path(), "config --print --set closures.submap_memory=0");
    CHECK(none.exit_code == 2);
    CHECK(contains(none.errors, "'closures.submap_memory' is out of range"));
  }
}
