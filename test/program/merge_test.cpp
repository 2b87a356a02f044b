#include <doctest/doctest.h>

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <span>
#include <string>
#include <vector>

#include "chainslam/io/detail/map_chunk.hpp"
#include "chainslam/io/map_archive.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "io/maps.hpp"
#include "program/keyframe_data.hpp"
#include "program/run_program.hpp"
#include "program/sessions.hpp"
#include "support/real_data.hpp"

namespace {

using namespace chainslam;
using namespace chainslam::test;

/// Drives along one circle, each mapped by itself: the longest has the first place in a merge.
struct DrivesApart {
  ScratchFolder scratch{"merge"};
  fs::path root = scratch.path();

  DrivesApart() {
    write_keyframes(root / "a", 44, true, 5);
    write_keyframes(root / "b", 40, true, 6);
    write_keyframes(root / "c", 37, true, 7);
    for (const char* name : {"a", "b", "c"}) map(name, std::string("only_") + name);
  }

  void map(const std::string& names, const std::string& out, const std::string& options = "") const {
    std::string data;
    for (const char name : names) data += quoted(root / std::string(1, name)) + " ";
    const ProgramResult result = run_program(root, "map " + data + "--out " + quoted(root / out) + " " + options);
    CAPTURE(result.errors);
    REQUIRE(result.exit_code == 0);
  }
  [[nodiscard]] ProgramResult merge(const std::vector<std::string>& maps, const std::string& out,
                                    const std::string& options = "") const {
    std::string arguments;
    for (const std::string& map : maps) arguments += quoted(root / map) + " ";
    return run_program(root, "merge " + arguments + options + " -o " + quoted(root / out));
  }
  [[nodiscard]] std::string load_option(const std::string& map) const { return "--load " + quoted(root / map); }
  [[nodiscard]] LoadedMap loaded(const std::string& map) const {
    return load_map(fs::is_directory(root / map) ? root / map / "map.cslam" : root / map);
  }
};

/// Mapped once; each test writes files of its own.
const DrivesApart& drives_apart() {
  static const DrivesApart drives;
  return drives;
}

}  // namespace

TEST_SUITE("program/merge") {
  TEST_CASE("two maps merge to the map that the second drive would have given on top of the first, in either order") {
    const DrivesApart& drives = drives_apart();
    drives.map("b", "b_on_a", drives.load_option("only_a"));
    const std::string before = read_text(drives.root / "only_b/map.cslam");
    const ProgramResult result = drives.merge({"only_a", "only_b/map.cslam"}, "ab.cslam");
    CAPTURE(result.errors);
    REQUIRE(result.exit_code == 0);
    CHECK(contains(result.output, "maps         2 with 2 different sessions\n"));
    CHECK(contains(result.output, "sessions     2 in 1 frame\n"));
    const LoadedMap expected = drives.loaded("b_on_a"), found = drives.loaded("ab.cslam");
    CHECK(std::ranges::any_of(found.map.keyframes, [](const Keyframe& one) { return one.gnss.has_value(); }));
    CHECK(std::ranges::any_of(found.map.closures, [](const LoopClosure& one) { return one.from.value < 44; }));
    CHECK(same_map(found.map, expected.map));
    CHECK(found.parameters == expected.parameters);
    REQUIRE(drives.merge({"only_b", "only_a"}, "ba.cslam", "--threads 1").exit_code == 0);
    CHECK(read_text(drives.root / "ba.cslam") == read_text(drives.root / "ab.cslam"));
    CHECK(read_text(drives.root / "only_b/map.cslam") == before);
    CHECK(run_program(drives.root, "check " + quoted(drives.root / "ab.cslam")).exit_code == 0);
  }

  TEST_CASE("three maps give the same file in any order; a map of two counts as its sessions") {
    const DrivesApart& drives = drives_apart();
    REQUIRE(drives.merge({"only_a", "only_b", "only_c"}, "abc.cslam").exit_code == 0);
    REQUIRE(drives.merge({"only_c", "only_a", "only_b"}, "cab.cslam").exit_code == 0);
    CHECK(read_text(drives.root / "abc.cslam") == read_text(drives.root / "cab.cslam"));
    const SlamMap map = drives.loaded("abc.cslam").map;
    REQUIRE(map.sessions.size() == 3);
    CHECK(frame_count(map) == 1);
    CHECK(map.sessions[2].name == "c");
    CHECK(map.keyframes.size() == 44 + 40 + 37);
    CHECK(map.keyframes.back().cloud.load()->positions ==
          drives.loaded("only_c").map.keyframes.back().cloud.load()->positions);
    drives.map("bc", "bc");
    REQUIRE(drives.merge({"only_a", "bc"}, "a_bc.cslam").exit_code == 0);
    CHECK(drives.loaded("a_bc.cslam").map.keyframes.size() == map.keyframes.size());
  }

  TEST_CASE("a session of several maps is taken once, from the map with the most of it, and the others are told") {
    const DrivesApart& drives = drives_apart();
    drives.map("b", "a_with_b", drives.load_option("only_a"));
    const ProgramResult same = drives.merge({"only_b", "only_a", "a_with_b"}, "saved_from.cslam");
    CAPTURE(same.errors);
    REQUIRE(same.exit_code == 0);
    CHECK(contains(same.output, "maps         3 with 2 different sessions\n"));
    CHECK(contains(same.output, "left out     session 0 (b) of " + (drives.root / "only_b/map.cslam").string() +
                                    ": 40 keyframes, of which session 1 (b) of " +
                                    (drives.root / "a_with_b/map.cslam").string() + " has 40\n"));
    const SlamMap merged = drives.loaded("saved_from.cslam").map, known = drives.loaded("a_with_b").map;
    CHECK(same_records(merged.closures, known.closures));  // nothing was searched again
    CHECK(merged.keyframes.size() == known.keyframes.size());

    // The map that comes first has the drive only in part.
    drives.map("ab", "ab_whole");
    drives.map("b", "a_with_part", drives.load_option("only_a") + " --max-scans 21");
    REQUIRE(drives.loaded("a_with_part").map.keyframes.size() == 44 + 21);
    for (const std::vector<std::string>& order :
         {std::vector<std::string>{"a_with_part", "only_b"}, std::vector<std::string>{"only_b", "a_with_part"}}) {
      const ProgramResult part = drives.merge(order, "completed.cslam", "--overwrite");
      REQUIRE(part.exit_code == 0);
      CHECK(contains(part.output, ": 21 keyframes, of which session 0 (b) of "));
      CHECK(same_map(drives.loaded("completed.cslam").map, drives.loaded("ab_whole").map));
    }
  }

  TEST_CASE("what matches nothing keeps a frame of its own, which is told, and missed if merging is the goal") {
    const DrivesApart& drives = drives_apart();
    write_keyframes(drives.root / "d", 30, false, 8, 250, 1.5, 99);
    drives.map("d", "elsewhere");
    const ProgramResult apart = drives.merge({"only_a", "elsewhere"}, "apart.cslam");
    CAPTURE(apart.errors);
    CHECK(apart.exit_code == 0);
    CHECK(contains(apart.output, "sessions     2 in 2 frames: 0 | 1\n"));
    CHECK(contains(apart.output, "elsewhere/map.cslam, frame 1\n"));
    const SlamMap map = drives.loaded("apart.cslam").map;
    CHECK(frame_count(map) == 2);
    CHECK(map.keyframes.size() == 44 + 30);
    CHECK(drives.merge({"only_a", "elsewhere"}, "goal.cslam", "--set goals.merged=true").exit_code == 5);
    CHECK(same_map(drives.loaded("goal.cslam").map, map));
  }

  TEST_CASE("settings are those of the first map, or given") {
    const DrivesApart& drives = drives_apart();
    const ProgramResult result = drives.merge({"only_a", "only_b"}, "unchained.cslam", "--set chain.enabled=false");
    REQUIRE(result.exit_code == 0);
    const LoadedMap map = drives.loaded("unchained.cslam");
    CHECK(std::ranges::none_of(map.map.closures, [](const LoopClosure& one) {
      return one.kind == ClosureKind::chained && one.to.value >= 44;
    }));
    drives.map("b", "b_unchained", drives.load_option("only_a") + " --set chain.enabled=false");
    CHECK(same_map(map.map, drives.loaded("b_unchained").map));
    CHECK(map.parameters == drives.loaded("b_unchained").parameters);
    write_text(drives.root / "unchained.toml", "[chain]\nenabled = false\n");
    REQUIRE(drives.merge({"only_a", "only_b"}, "by_file.cslam", "--config " + quoted(drives.root / "unchained.toml"))
                .exit_code == 0);
    CHECK(read_text(drives.root / "by_file.cslam") == read_text(drives.root / "unchained.cslam"));
    drives.map("c", "c_unchained", "--set chain.enabled=false");
    const ProgramResult mixed = drives.merge({"c_unchained", "only_a"}, "mixed.cslam");
    CHECK(contains(mixed.errors, "c_unchained/map.cslam: made with other settings than "));
    CHECK(drives.loaded("mixed.cslam").parameters == drives.loaded("only_a").parameters);
  }

  TEST_CASE("inputs that cannot be used and outputs that are there end it with the usual errors") {
    const DrivesApart& drives = drives_apart();
    const std::string whole = read_text(drives.root / "only_b/map.cslam");
    write_text(drives.root / "cut.cslam", whole.substr(0, whole.size() - 200));
    std::string newer = whole;
    newer[8] = 2;  // the major version
    const auto bytes = std::as_bytes(std::span(newer));
    const std::uint64_t hash = chainslam::detail::hash_of(bytes.first(56));
    std::memcpy(newer.data() + 56, &hash, 8);
    write_text(drives.root / "newer.cslam", newer);
    write_text(drives.root / "taken.cslam", "mine");
    const auto refused = [&](const std::vector<std::string>& maps, const std::string& out, int code,
                             const std::string& what) {
      const ProgramResult result = drives.merge(maps, out);
      CAPTURE(result.errors);
      CHECK(result.exit_code == code);
      CHECK(contains(result.errors, what));
      CHECK(!fs::exists(drives.root / (out + ".partial")));
      CHECK((out != "refused.cslam" || !fs::exists(drives.root / out)));
    };
    refused({"only_a", "none.cslam"}, "refused.cslam", 3, "none.cslam");
    refused({"only_a", "cut.cslam"}, "refused.cslam", 3, "do: `chainslam recover` recovers");
    refused({"only_a", "newer.cslam"}, "refused.cslam", 3, "newer.cslam");
    refused({"only_a", "a"}, "refused.cslam", 3, "a/map.cslam");
    refused({"only_a"}, "refused.cslam", 2, "At least 2 required");
    refused({"only_a", "only_b"}, "only_b/map.cslam", 4, "a map is never changed");
    refused({"only_a", "only_b"}, "taken.cslam", 4, "--overwrite");
    CHECK(read_text(drives.root / "taken.cslam") == "mine");
    CHECK(read_text(drives.root / "only_b/map.cslam") == whole);
    CHECK(drives.merge({"only_a", "only_b"}, "taken.cslam", "--overwrite").exit_code == 0);
    CHECK(read_text(drives.root / "taken.cslam~1") == "mine");
  }

  TEST_CASE("hku_square_two_sessions: two walks that were mapped apart become one map") {
    const auto data = real_data("hku_square_two_sessions");
    if (!data) return;
    const ScratchFolder scratch("merge_hku");
    const auto succeed = [&](const std::string& arguments) {
      const ProgramResult result = run_program(scratch.path(), arguments);
      CAPTURE(result.errors);
      REQUIRE(result.exit_code == 0);
    };
    const fs::path one = scratch.path() / "one", two = scratch.path() / "two", out = scratch.path() / "both.cslam";
    succeed("map " + quoted(*data / "session1") + " --out " + quoted(one));
    succeed("map " + quoted(*data / "session2") + " --out " + quoted(two));
    succeed("merge " + quoted(two) + " " + quoted(one) + " --set goals.merged=true -o " + quoted(out));
    const fs::path reversed = scratch.path() / "reversed.cslam";
    succeed("merge " + quoted(one) + " " + quoted(two) + " --set goals.merged=true --threads 1 -o " + quoted(reversed));
    CHECK(read_text(out) == read_text(reversed));
    const SlamMap map = load_map(out).map;
    REQUIRE(map.sessions.size() == 2);
    const std::size_t first = map.sessions[0].name == "session1" ? 0 : 1;
    const SE3d T_1_2 = read_matrix(*data / "T_session1_session2.txt");
    const SE3d T_map_1 = fitted(map, first, read_kitti_poses(*data / "session1" / "optimized_poses.txt").poses);
    const SE3d T_map_2 = fitted(map, 1 - first, read_kitti_poses(*data / "session2" / "optimized_poses.txt").poses);
    const SE3d error = T_1_2.inverse() * T_map_1.inverse() * T_map_2;
    std::printf("FIGURE hku, maps merged without fixes: T_1_2 off by %.3f m, %.2f deg\n", error.translation().norm(),
                in_degrees(error));
    CHECK(error.translation().norm() < 0.2);
    CHECK(in_degrees(error) < 1.0);
  }
}
