#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <string>
#include <variant>
#include <vector>

#include "chainslam/io/input_journal.hpp"
#include "chainslam/io/map_archive.hpp"
#include "program/faults.hpp"
#include "program/keyframe_data.hpp"
#include "program/run_program.hpp"

#include <doctest/doctest.h>

namespace {

using namespace chainslam;
using namespace chainslam::test;

/// A verb whose operations on files are to fail, and where its result is.
struct FaultyVerb {
  std::string name, command;
  fs::path result;     ///< a file or a folder, which holds an older result before
  std::string inside;  ///< the file in a result's folder that is compared; "" if the result is a file
};

/// Scenarios in a folder: what each needs is made once.
class FaultyVerbs {
 public:
  explicit FaultyVerbs(const fs::path& root) : root_(root) {
    write_keyframes(root / "data", 3, true, 5, 20);
    write_keyframes(root / "walk", 40, true);
    write_keyframes(root / "next", 8, true, 7);
    run("map " + quoted(root / "data") + " --out " + quoted(root / "small"));
    run("map " + quoted(root / "walk") + " --out " + quoted(root / "first"));
    static_cast<void>(run_program(root, "map " + quoted(root / "data") + " --out " + quoted(root / "killed"),
                                  with_fault("sync:input.cslam:-1:1")));
    REQUIRE(fs::exists(root / "killed.partial/input.cslam.partial"));
    fs::create_directories(root / "old");
    write_text(root / "old/map.cslam", "an older map");
    write_text(root / "old/joint.tum", "an older trajectory");
    write_text(root / "old/images.txt", "older views");
    write_text(root / "old.file", "an older file");
    const std::string small = quoted(root / "small/map.cslam"), out = " --overwrite --out " + quoted(root / "out");
    const std::string left = quoted(root / "killed.partial");
    verbs_ = {{"map", "map " + quoted(root / "data") + out, root / "out", "map.cslam"},
              {"load and merge", "map " + quoted(root / "next") + " --load " + quoted(root / "first") + out,
               root / "out", "map.cslam"},
              {"save", "recover " + small + out, root / "out", ""},
              {"recover", "recover " + left + out, root / "out", ""},
              {"export tum", "export " + small + " --format tum" + out, root / "out", "joint.tum"},
              {"export g2o", "export " + small + " --format g2o" + out, root / "out", ""},
              {"export pcd", "export " + small + " --format pcd" + out, root / "out", ""},
              {"export colmap", "export " + small + " --format colmap" + out, root / "out", "images.txt"}};
  }

  [[nodiscard]] const std::vector<FaultyVerb>& verbs() const { return verbs_; }

  /// Removes what a verb left, and puts the older result where its result goes.
  void prepare(const FaultyVerb& verb) const {
    for (const std::string& name : names_in(root_))
      if (name.starts_with("out")) fs::remove_all(root_ / name);
    fs::remove(root_ / "log");
    fs::copy(root_ / (verb.inside.empty() ? "old.file" : "old"), verb.result, fs::copy_options::recursive);
  }

  [[nodiscard]] static std::string content(const FaultyVerb& verb, const std::string& suffix = "") {
    const fs::path result = verb.result.string() + suffix;
    return read_text(verb.inside.empty() ? result : result / verb.inside);
  }

 private:
  void run(const std::string& arguments) const {
    const ProgramResult result = run_program(root_, arguments);
    CAPTURE(result.errors);
    REQUIRE(result.exit_code == 0);
  }

  fs::path root_;
  std::vector<FaultyVerb> verbs_;
};

/// Cuts the power at each of the first syncs of a mapping run's inputs.
/// @param check  called with the scans that the progress line had shown by then, and what is on the disk.
/// @returns the most scans that were shown.
template <class Check>
int shown_before_power_cuts(const fs::path& root, const std::string& command, const std::string& mark, Check&& check) {
  const fs::path left = root / "out.partial";
  int cuts = 0, most = 0;
  for (int number = 0; number < 12; ++number) {
    const ProgramResult result = run_program(root, command + " --out " + quoted(root / "out"),
                                             with_fault("sync:input.cslam:-1:" + std::to_string(number)));
    if (result.exit_code == 0) break;  // it has fewer syncs
    CAPTURE(number);
    CAPTURE(result.errors);
    REQUIRE(result.exit_code == 128 + SIGKILL);
    int shown = 0;
    for (std::size_t at = result.errors.find(mark); at != std::string::npos; at = result.errors.find(mark, at + 1))
      shown = std::stoi(result.errors.substr(at + mark.size()));
    most = std::max(most, shown);
    ++cuts;
    JournaledInput safe;
    try {
      safe = read_input_journal(left / "input.cslam.partial");
    } catch (const IoError&) {  // nothing was committed yet
    }
    check(shown, safe);
    fs::remove_all(left);
  }
  CHECK(cuts >= 3);
  return most;
}

}  // namespace

TEST_SUITE("program/every fault") {
  TEST_CASE(
      "every operation of mapping, loading, merging, saving, recovering and exporting fails once with every error") {
    const ScratchFolder scratch("every_fault");
    const fs::path root = scratch.path(), log = root / "log", count = root / "count";
    const FaultyVerbs scenarios(root);
    const std::vector<int> errors{ENOSPC, EIO, EDQUOT, EINTR, 0};  // 0: short writes
    const std::string place = root.filename().string() + "/";
    int failures = 0, refused = 0;
    for (const FaultyVerb& verb : scenarios.verbs()) {
      CAPTURE(verb.name);
      scenarios.prepare(verb);
      const std::string old = FaultyVerbs::content(verb);
      fs::remove(count);
      REQUIRE(run_program(root, verb.command,
                          with_fault("any:" + place + ":5:1000000") + " CHAINSLAM_FAULT_COUNT=" + quoted(count))
                  .exit_code == 0);
      const std::string fresh = FaultyVerbs::content(verb);
      REQUIRE(!fresh.empty());
      if (verb.name == "load and merge") {
        const SlamMap merged = load_map(verb.result / "map.cslam").map;
        CHECK(std::ranges::count(merged.closures, ClosureKind::merge, &LoopClosure::kind) > 0);
      }
      const long operations = std::stol(read_text(count));
      CHECK(operations > 5);
      // By default three or four of them, each with one of the errors in turn.
      const long step = full() ? 1 : std::max(1L, operations / 3);
      long turn = 0;
      for (long number = full() ? 0 : step / 2; number < operations; number += step, ++turn)
        for (std::size_t e = 0; e < errors.size(); ++e) {
          if (!full() && e != static_cast<std::size_t>(turn + failures) % errors.size()) continue;
          scenarios.prepare(verb);
          const ProgramResult result = run_program(
              root, verb.command,
              with_fault("any:" + place + ":" + std::to_string(errors[e]) + ":" + std::to_string(number), log));
          const std::string met = read_text(log), found = FaultyVerbs::content(verb);
          CAPTURE(errors[e]);
          CAPTURE(number);
          CAPTURE(met);
          CAPTURE(result.errors);
          ++failures;
          refused += result.exit_code != 0;
          const bool is_new = found == fresh && FaultyVerbs::content(verb, "~1") == old;
          if (result.exit_code == 0) {
            // A scan that cannot be read is left out, and said to be.
            const bool without_scan = contains(result.errors, "left out") && contains(met, "/Scans/") &&
                                      !found.empty() && FaultyVerbs::content(verb, "~1") == old;
            CHECK((is_new || without_scan));
          } else {
            CHECK((result.exit_code == 3 || result.exit_code == 4));
            CHECK(three_lines(result.errors));
            // Of several files one may have failed: then the others are written, and the older ones kept.
            const bool others = contains(verb.command, "--format tum") && found.empty() &&
                                FaultyVerbs::content(verb, "~1") == old && result.exit_code == 4;
            CHECK((found == old || is_new || others));
          }
          // What a signal interrupts and what is written in part is done again.
          if (errors[e] == EINTR || errors[e] == 0) CHECK(result.exit_code == 0);
        }
    }
    std::printf(
        "FIGURE operations of the program that failed: %d, %d with an error, the others done again or without "
        "consequence; the old result or the new one was there each time\n",
        failures, refused);
    CHECK(refused > failures / 4);
  }

  TEST_CASE("a signal that interrupts the opening of an input file only delays it") {
    const ScratchFolder scratch("interrupted_opening");
    const fs::path root = scratch.path(), log = root / "log";
    write_keyframes(root / "data", 3, true, 5, 20);
    REQUIRE(run_program(root, "map " + quoted(root / "data") + " --out " + quoted(root / "first")).exit_code == 0);
    const std::string command = "map " + quoted(root / "data") + " --load " + quoted(root / "first") +
                                " --overwrite --out " + quoted(root / "out");
    for (const std::string file : {"times.txt", "odom_poses.txt", "gnss.txt", "000000.pcd", "first/map.cslam"}) {
      CAPTURE(file);
      fs::remove(log);
      const ProgramResult result =
          run_program(root, command, with_fault("open:" + file + ":" + std::to_string(EINTR) + ":0", log));
      CAPTURE(result.errors);
      CHECK(result.exit_code == 0);
      CHECK_FALSE(contains(result.errors, "left out"));
      CHECK(contains(read_text(log), file));
    }
  }

  TEST_CASE("a run ends whose map cannot be written any more when all data have been read") {
    const ScratchFolder scratch("late_fault");
    const fs::path root = scratch.path(), log = root / "log";
    write_keyframes(root / "data", 24, true);
    int ended = 0;
    for (int number = 1; number < 40; number += full() ? 1 : 4) {
      const ProgramResult result = run_program(
          root, "map " + quoted(root / "data") + " --threads 1 --overwrite --out " + quoted(root / "out"),
          with_fault("write:map.cslam:28:" + std::to_string(number) + ":stay", log) + " timeout -s KILL 120");
      if (result.exit_code == 0) break;  // it has fewer writes
      CAPTURE(number);
      CAPTURE(result.errors);
      REQUIRE(result.exit_code == 4);
      CHECK(three_lines(result.errors));
      CHECK(contains(result.errors, "`chainslam recover "));
      ++ended;
      fs::remove_all(root / "out.partial");
    }
    CHECK(ended >= 5);
  }

  TEST_CASE("the folder that a run's journal is in is on the disk before anything is acknowledged") {
    const ScratchFolder scratch("entry");
    const fs::path root = scratch.path(), log = root / "log";
    write_keyframes(root / "data", 3, false, 5, 20);
    fs::create_directories(root / "results");
    // The second sync of that folder is that of the finished map's name.
    const std::string command = "map " + quoted(root / "data") + " --out ";
    const ProgramResult failed =
        run_program(root, command + quoted(root / "results/out"), with_fault("sync:/results$:5:0", log));
    CAPTURE(failed.errors);
    CHECK(failed.exit_code == 4);
    CHECK(three_lines(failed.errors));
    CHECK(fs::is_empty(root / "results"));
    CHECK(contains(read_text(log), "sync "));
    // The folders above are made and kept, too.
    const ProgramResult deep = run_program(root, command + quoted(root / "a/b/out"), with_fault("sync:/a$:5:0", log));
    CHECK(deep.exit_code == 4);
    CHECK(run_program(root, command + quoted(root / "a/b/out")).exit_code == 0);
  }

  TEST_CASE("what the progress line shows of recorded odometry is on the disk, whenever the power fails") {
    const ScratchFolder scratch("acknowledged");
    write_keyframes(scratch.path() / "data", 200, true, 5, 20, 0.4);
    const std::string command = "map " + quoted(scratch.path() / "data");
    const int shown =
        shown_before_power_cuts(scratch.path(), command, "mapping data ", [](int scans, const JournaledInput& safe) {
          CHECK(scans <= safe.keyframes);  // each frame is one
        });
    CHECK(shown >= 20);
  }

  TEST_CASE("what the progress line shows is on the disk, but for the last second of data, whenever the power fails") {
    const ScratchFolder scratch("last_second");
    const int shown = shown_before_power_cuts(
        scratch.path(), "map simulate:town-sessions/small/1 --max-scans 60 --threads 1", "mapping town-sessions-1 ",
        [](int scans, const JournaledInput& safe) {
          Index frames = 0;
          for (const MapInput& input : safe.inputs)
            if (const auto* some = std::get_if<std::vector<FrameRecord>>(&input)) frames += to_index(some->size());
          constexpr Index at_once = 2;  // a scan waits for the IMU, and the first has nothing before it
          CHECK(scans - frames <= 10 + at_once);
        });
    CHECK(shown >= 30);
  }
}
