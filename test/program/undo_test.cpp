#include <doctest/doctest.h>

#include <algorithm>
#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "chainslam/io/map_archive.hpp"
#include "io/maps.hpp"
#include "program/keyframe_data.hpp"
#include "program/run_program.hpp"
#include "program/sessions.hpp"
#include "support/real_data.hpp"

namespace {

using namespace chainslam;
using namespace chainslam::test;

/// Three drives along one circle, each with fixes and odometry of its own, and what they are mapped to.
struct ThreeDrives {
  ScratchFolder scratch{"undo"};
  fs::path root = scratch.path(), all = root / "all";

  ThreeDrives() {
    for (const char* name : {"a", "b", "c"})
      write_keyframes(root / name, 40, true, static_cast<std::uint64_t>(5 + name[0] - 'a'));
    REQUIRE(map("a b c", all) == 0);
  }

  [[nodiscard]] int map(const std::string& names, const fs::path& out) const {
    std::string data;
    for (const char name : names)
      if (name != ' ') data += quoted(root / std::string(1, name)) + " ";
    return run_program(root, "map " + data + "--out " + quoted(out)).exit_code;
  }
  [[nodiscard]] ProgramResult undo(const std::string& options, const fs::path& out) const {
    return run_program(root, "undo " + quoted(all) + " " + options + " -o " + quoted(out));
  }
  [[nodiscard]] SlamMap mapped() const { return load_map(all / "map.cslam").map; }
};

/// Mapped once; each test writes files of its own.
const ThreeDrives& three_drives() {
  static const ThreeDrives drives;
  return drives;
}

Index number_of(const SlamMap& map, ClosureKind kind) {
  const auto found = std::ranges::find_if(map.closures, [&](const LoopClosure& closure) {
    return closure.kind == kind && closure.verdict != ClosureVerdict::reverted;
  });
  REQUIRE(found != map.closures.end());
  return static_cast<Index>(found - map.closures.begin());
}

}  // namespace

TEST_SUITE("program/undo") {
  TEST_CASE("a session that is undone with --replay might never have been there") {
    const ThreeDrives& drives = three_drives();
    const SlamMap map = drives.mapped();
    REQUIRE(frame_count(map) == 1);
    CHECK(std::ranges::any_of(map.keyframes, [](const Keyframe& one) { return one.gnss.has_value(); }));
    const fs::path never = drives.root / "never", undone = drives.root / "remade.cslam";
    REQUIRE(drives.map("a c", never) == 0);
    const ProgramResult result = drives.undo("--session b --replay", undone);
    CAPTURE(result.errors);
    REQUIRE(result.exit_code == 0);
    CHECK(contains(result.output, "removed      1 of 3 sessions with 40 keyframes"));
    CHECK(contains(result.output, "sessions     2 in 1 frame\n"));
    const LoadedMap expected = load_map(never / "map.cslam"), found = load_map(undone);
    CHECK(same_map(found.map, expected.map));
    CHECK(found.parameters == expected.parameters);
    CHECK(same_map(drives.mapped(), map));  // which stays
  }

  TEST_CASE("without --replay, what does not descend from it stays as it was measured") {
    const ThreeDrives& drives = three_drives();
    const SlamMap map = drives.mapped();
    const fs::path out = drives.root / "left.cslam";
    const ProgramResult result = drives.undo("--session 1", out);
    CAPTURE(result.errors);
    REQUIRE(result.exit_code == 0);
    const SlamMap left = load_map(out).map;
    REQUIRE(left.sessions.size() == 2);
    CHECK(left.sessions[1].name == "c");
    CHECK(left.keyframes.size() == 80);
    CHECK(left.keyframes[40].cloud.load()->positions == map.keyframes[80].cloud.load()->positions);
    std::vector<SE3d> kept;
    for (const LoopClosure& closure : map.closures) kept.push_back(closure.T_from_to);
    for (const LoopClosure& closure : left.closures) CHECK(std::ranges::find(kept, closure.T_from_to) != kept.end());
    CHECK(left.closures.size() < map.closures.size());
    CHECK(run_program(drives.root, "check " + quoted(out)).exit_code == 0);
    // It can be worked with like any other.
    const fs::path more = drives.root / "more";
    CHECK(run_program(drives.root,
                      "map " + quoted(drives.root / "b") + " --load " + quoted(out) + " --out " + quoted(more))
              .exit_code == 0);
    CHECK(load_map(more / "map.cslam").map.sessions.size() == 3);
  }

  TEST_CASE("a closure and a merge go by their numbers, and a replay does not find them again") {
    const ThreeDrives& drives = three_drives();
    const SlamMap map = drives.mapped();
    const Index direct = number_of(map, ClosureKind::direct), merge = number_of(map, ClosureKind::merge);
    for (const bool again : {false, true}) {
      CAPTURE(again);
      const std::string replay = again ? " --replay" : "";
      const fs::path out = drives.root / "undone.cslam";
      REQUIRE(drives.undo("--overwrite --closure " + std::to_string(direct) + replay, out).exit_code == 0);
      const LoopClosure& closure = map.closures[static_cast<std::size_t>(direct)];
      const SlamMap unclosed = load_map(out).map;
      CHECK(unclosed.keyframes.size() == map.keyframes.size());
      CHECK(std::ranges::none_of(
          unclosed.closures, [&](const LoopClosure& one) { return one.from == closure.from && one.to == closure.to; }));
      const ProgramResult parted = drives.undo("--overwrite --merge " + std::to_string(merge) + replay, out);
      REQUIRE(parted.exit_code == 0);
      const SlamMap unmerged = load_map(out).map;
      const LoopClosure& place = map.closures[static_cast<std::size_t>(merge)];
      const auto is_between = [&](const LoopClosure& one) {
        const auto session = [&](KeyframeId id) { return map.keyframes[static_cast<std::size_t>(id.value)].session; };
        return one.kind == ClosureKind::merge && session(one.from) == session(place.from) &&
               session(one.to) == session(place.to);
      };
      CHECK(std::ranges::none_of(unmerged.closures, is_between));
      if (again) {  // the third drive may bring the two together
        CHECK(std::ranges::any_of(unmerged.refusals, [&](const LoopClosure& one) {
          return is_between(one) && one.verdict == ClosureVerdict::reverted;
        }));
      } else {
        CHECK(frame_count(unmerged) > 1);
        CHECK(contains(parted.output, "more frames than before"));
      }
    }
    const fs::path out = drives.root / "other.cslam";
    const auto refused = [&](const std::string& options, int code, const std::string& what) {
      const ProgramResult result = drives.undo(options, out);
      CAPTURE(result.errors);
      CHECK(result.exit_code == code);
      CHECK(contains(result.errors, what));
      CHECK(std::ranges::count(result.errors, '\n') == 3);
      CHECK(!fs::exists(out));
    };
    refused("", 2, "nothing to undo: pass --session, --closure or --merge");
    refused("--session d", 2, "found: d, where the map has sessions 0 to 2");
    refused("--session 0 --session 1 --session c", 2, "found: all sessions of the map");
    refused("--closure 100000", 2, "closures\n");
    refused("--closure " + std::to_string(merge), 2, "do: pass --merge " + std::to_string(merge));
    refused("--merge " + std::to_string(direct), 2, "do: pass --closure " + std::to_string(direct));
    const ProgramResult itself = drives.undo("--session 0 --overwrite", drives.all / "map.cslam");
    CHECK(itself.exit_code == 4);
    CHECK(contains(itself.errors, "choose another name: a map is never changed"));
    CHECK(drives.undo("--session 0", drives.root / "undone.cslam").exit_code == 4);  // which is there
    CHECK(fs::exists(drives.root / "undone.cslam~1"));
    CHECK(same_map(drives.mapped(), map));
  }

  TEST_CASE("a replay says if the map does not state when its fixes came") {
    const ScratchFolder scratch("undo_earlier");
    const std::string note = "does not say when GNSS fixes came";
    for (const char* minor : {"3", "4"}) {
      const fs::path golden = std::string(CHAINSLAM_SOURCE_DIR) + "/test/io/golden/map_1_" + minor + ".cslam";
      const ProgramResult result =
          run_program(scratch.path(), "undo " + quoted(golden) + " --session 1 --replay -o " +
                                          quoted(scratch.path() / (std::string("undone") + minor)));
      CHECK(result.exit_code == 0);
      CHECK(contains(result.errors, note) == (minor[0] == '3'));
    }
  }

  TEST_CASE("hku_square_two_sessions: what is left of two walks is the map of one") {
    const auto data = real_data("hku_square_two_sessions");
    if (!data) return;
    const ScratchFolder scratch("undo_hku");
    const auto succeed = [&](const std::string& arguments) {
      const ProgramResult result = run_program(scratch.path(), arguments);
      CAPTURE(result.errors);
      REQUIRE(result.exit_code == 0);
    };
    const std::string walks[] = {quoted(*data / "session1"), quoted(*data / "session2")};
    const fs::path both = scratch.path() / "both";
    succeed("map " + walks[0] + " " + walks[1] + " --set goals.merged=true --out " + quoted(both));
    for (int left = 0; left < 2; ++left) {
      CAPTURE(left);
      const fs::path alone = scratch.path() / ("alone" + std::to_string(left)),
                     undone = scratch.path() / ("undone" + std::to_string(left));
      succeed("map " + walks[left] + " --out " + quoted(alone));
      const SlamMap expected = load_map(alone / "map.cslam").map;
      const std::string undo =
          "undo " + quoted(both) + " --session " + std::to_string(1 - left) + " -o " + quoted(undone);
      succeed(undo + " --replay");
      CHECK(same_map(load_map(undone).map, expected));
      if (left != 0) continue;  // the second walk has closures that it found since it had been moved
      succeed(undo + " --overwrite");
      const SlamMap found = load_map(undone).map;
      REQUIRE(same_records(found.closures, expected.closures));
      double most = 0;
      for (std::size_t i = 0; i < expected.keyframes.size(); ++i)
        most = std::max(most, expected.keyframes[i].T_map_body.local(found.keyframes[i].T_map_body).norm());
      std::printf("FIGURE hku_square, second walk undone: poses within %.2g m and rad of the first one's map\n", most);
      CHECK(most < 1e-9);
    }
  }

  TEST_CASE("the report of a map is made again from the map alone") {
    const ThreeDrives& drives = three_drives();
    const fs::path again = drives.root / "again";
    const std::string command = "report " + quoted(drives.all / "map.cslam") + " --out " + quoted(again);
    const ProgramResult result = run_program(drives.root, command);
    CAPTURE(result.errors);
    REQUIRE(result.exit_code == 0);
    CHECK(contains(result.output, "verdict      good"));
    for (const char* name : {"map.ply", "map.png"})
      CHECK_MESSAGE(read_text(again / name) == read_text(drives.all / name), name);
    const std::string page = read_text(again / "report.html"), first = read_text(drives.all / "report.html");
    for (const std::string label : {"Direct closures", "Chained closures", "Sessions merged", "a, b, c"}) {
      CHECK_MESSAGE(contains(page, label), label);
      CHECK_MESSAGE(contains(first, label), label);
    }
    CHECK(contains(page, "made from the map alone"));
    CHECK_FALSE(contains(page, "times real time"));
    CHECK(contains(first, "times real time"));
    CHECK(run_program(drives.root, command).exit_code == 4);
    CHECK(run_program(drives.root, command + " --overwrite").exit_code == 0);
    CHECK(fs::exists(drives.root / "again~1" / "report.html"));
    const ProgramResult none =
        run_program(drives.root, "report " + quoted(drives.root / "a") + " --out " + quoted(drives.root / "none"));
    CHECK(none.exit_code == 3);
    CHECK(!fs::exists(drives.root / "none"));
    CHECK(!fs::exists(drives.root / "none.partial"));
  }

  TEST_CASE("inspect says of each closure why it was tried and what became of it, also for programs") {
    const ThreeDrives& drives = three_drives();
    const SlamMap map = drives.mapped();
    const auto json =
        nlohmann::json::parse(run_program(drives.root, "inspect " + quoted(drives.all) + " --closures --json").output);
    const auto& closures = json["closures"];
    REQUIRE(closures.size() == map.closures.size() + map.refusals.size());
    Index merges = 0, rechecked = 0;
    for (std::size_t i = 0; i < closures.size(); ++i) {
      const bool kept = i < map.closures.size();
      const LoopClosure& closure = kept ? map.closures[i] : map.refusals[i - map.closures.size()];
      const auto& entry = closures[i];
      CHECK(entry["number"].is_null() != kept);
      if (kept) CHECK(entry["number"] == i);
      CHECK(entry["from"] == closure.from.value);
      CHECK(entry["to_session"] == map.keyframes[static_cast<std::size_t>(closure.to.value)].session.value);
      CHECK(entry["cause"].is_null() == (closure.cause < 0));
      CHECK(entry["T_from_to"][0] == closure.T_from_to.translation().x());
      const std::string outcome = entry["outcome"], tried = entry["tried"];
      CHECK(outcome.starts_with("refused: ") != kept);
      CHECK_FALSE(tried.empty());
      merges += kept && closure.kind == ClosureKind::merge && tried == "place recognition between two frames";
      rechecked += tried.starts_with("searched again after merge ");
    }
    CHECK(merges > 0);
    CHECK(rechecked > 0);
    const ProgramResult table = run_program(drives.root, "inspect " + quoted(drives.all) + " --closures");
    const auto lines = static_cast<std::size_t>(std::ranges::count(table.output, '\n'));
    CHECK(lines > map.closures.size() + map.refusals.size());
    CHECK(contains(table.output, "tried because"));
  }
}
