#include <algorithm>
#include <csignal>
#include <cstdio>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/io/input_journal.hpp"
#include "chainslam/io/map_archive.hpp"
#include "io/maps.hpp"
#include "program/keyframe_data.hpp"
#include "program/running.hpp"

#include <doctest/doctest.h>

namespace {

using namespace chainslam;
using namespace chainslam::test;

/// A file that is just being made may be too short to be read.
template <class Read>
void try_reading(const Read& read) {
  try {
    read();
  } catch (const IoError&) {
  }
}

/// Whether a map has the first keyframes of another.
bool begins_with(const SlamMap& whole, const SlamMap& part) {
  return part.keyframes.size() <= whole.keyframes.size() &&
         std::equal(
             part.keyframes.begin(), part.keyframes.end(), whole.keyframes.begin(),
             [](const Keyframe& a, const Keyframe& b) { return same_record(a, b) && same_cloud(a.cloud, b.cloud); });
}

ProgramResult good(const fs::path& scratch, const std::string& arguments) {
  ProgramResult result = run_program(scratch, arguments);
  CAPTURE(arguments);
  CAPTURE(result.errors);
  REQUIRE(result.exit_code == 0);
  return result;
}

}  // namespace

TEST_SUITE("program/kill") {
  TEST_CASE("a run that is killed at any moment: recover makes the map of an undisturbed run, and mapping goes on") {
    const ScratchFolder scratch("kill_run");
    const fs::path root = scratch.path(), data = root / "data", next = root / "next", out = root / "out";
    const Index keyframes = 40;
    write_keyframes(data, keyframes, true);
    write_keyframes(next, 8, true, 7);
    const auto begin = Clock::now();
    good(root, "map " + quoted(data) + " --out " + quoted(root / "whole"));
    const double whole_run = seconds_since(begin);
    const SlamMap whole = load_map(root / "whole/map.cslam").map;
    REQUIRE(to_index(whole.keyframes.size()) == keyframes);
    CHECK(!whole.closures.empty());

    Rng rng(full() ? 2 : 1);
    const int kills = full() ? 140 : 11;
    int unfinished = 0, recovered_all = 0, went_on = 0;
    for (int i = 0; i < kills; ++i) {
      CAPTURE(i);
      {
        Running run({"map", data.string(), "--out", out.string()}, root / "errors");
        sleep_for(rng.uniform(0, 1.1 * whole_run));
        run.signal(SIGKILL);
        static_cast<void>(run.wait());
      }
      const fs::path left = out.string() + ".partial", map = root / "recovered.cslam";
      if (fs::exists(out)) {  // the map had its name already
        CHECK(read_text(out / "map.cslam") == read_text(root / "whole/map.cslam"));
      } else if (fs::exists(left / "input.cslam.partial") || fs::exists(left / "map.cslam")) {
        const bool saved = fs::exists(left / "map.cslam");
        const ProgramResult result =
            run_program(root, "recover " + quoted(left) + " --out " + quoted(map) + " --threads 1");
        CAPTURE(result.errors);
        Index acknowledged = 0;
        if (!saved) try_reading([&] { acknowledged = read_input_journal(left / "input.cslam.partial").keyframes; });
        if (acknowledged == 0 && !saved) {
          CHECK(result.exit_code == 3);  // it was killed before the first keyframe came
        } else {
          REQUIRE(result.exit_code == 0);
          ++unfinished;
          const auto count = to_index(load_map(map).map.keyframes.size());
          CHECK((saved || count == acknowledged));
          recovered_all += count == keyframes;
          CHECK(begins_with(whole, load_map(map).map));
          if (full() || unfinished % 2 == 1) {  // an undisturbed run of as many
            const fs::path same = root / ("same" + std::to_string(count));
            if (!fs::exists(same))
              good(root, "map " + quoted(data) + " --out " + quoted(same) + " --max-scans " + std::to_string(count));
            // A map that had been saved is copied, in one piece; what is made again is the same file.
            CHECK(same_map(load_map(map).map, load_map(same / "map.cslam").map));
            CHECK((saved || read_text(map) == read_text(same / "map.cslam")));
            if (unfinished % 3 == 1) {  // and goes on: the same map again
              for (const auto& [from, to] : {std::pair(map, "next1"), std::pair(same / "map.cslam", "next2")})
                good(root, "map " + quoted(next) + " --load " + quoted(from) + " --out " + quoted(root / to));
              CHECK(read_text(root / "next1/map.cslam") == read_text(root / "next2/map.cslam"));
              ++went_on;
            }
          }
        }
      }
      for (const char* name : {"out", "out.partial", "recovered.cslam", "next1", "next2"}) fs::remove_all(root / name);
    }
    std::printf(
        "FIGURE kill -9 at %d moments of a run: %d left work to recover, %d of these the whole run's; %d went on\n",
        kills, unfinished, recovered_all, went_on);
    CHECK(unfinished > kills / 5);
  }

  TEST_CASE("a run on top of a loaded map is recovered with that map, and only with that one") {
    const ScratchFolder scratch("kill_load");
    const fs::path root = scratch.path(), out = root / "out", left = root / "out.partial";
    write_keyframes(root / "data", 40, true);
    write_keyframes(root / "next", 40, true, 7);
    good(root, "map " + quoted(root / "data") + " --out " + quoted(root / "first"));
    const std::string arguments =
        "map " + quoted(root / "next") + " --load " + quoted(root / "first") + " --threads 1 --out ";
    const auto begin = Clock::now();
    good(root, arguments + quoted(root / "whole"));
    const double whole_run = seconds_since(begin);
    const SlamMap whole = load_map(root / "whole/map.cslam").map;
    Rng rng(5);
    for (int i = 0; i < (full() ? 40 : 4); ++i) {  // at random moments, loading among them
      CAPTURE(i);
      {
        Running run({"map", (root / "next").string(), "--load", (root / "first").string(), "--out", out.string()},
                    root / "errors");
        sleep_for(rng.uniform(0, 1.1 * whole_run));
        run.signal(SIGKILL);
        static_cast<void>(run.wait());
      }
      CHECK(load_map(root / "first/map.cslam").map.keyframes.size() == 40);
      Index acknowledged = 0;
      try_reading([&] { acknowledged = read_input_journal(left / "input.cslam.partial").keyframes; });
      if (fs::exists(out)) CHECK(read_text(out / "map.cslam") == read_text(root / "whole/map.cslam"));
      if (acknowledged > 0 && !fs::exists(left / "map.cslam")) {
        good(root, "recover " + quoted(left) + " --out " + quoted(root / "recovered.cslam"));
        const SlamMap recovered = load_map(root / "recovered.cslam").map;
        CHECK(to_index(recovered.keyframes.size()) == 40 + acknowledged);
        CHECK(begins_with(whole, recovered));
        if (acknowledged == 40) CHECK(read_text(root / "recovered.cslam") == read_text(root / "whole/map.cslam"));
      }
      for (const char* name : {"out", "out.partial", "recovered.cslam"}) fs::remove_all(root / name);
    }
    {
      // Killed where all inputs are in the journal, and loops are still being closed.
      Running run({"map", (root / "next").string(), "--load", (root / "first").string(), "--out", out.string()},
                  root / "errors");
      for (int i = 0; i < 1000 && !fs::exists(out); ++i) {
        sleep_for(0.003);
        Index keyframes = 0;
        try_reading([&] { keyframes = read_input_journal(left / "input.cslam.partial").keyframes; });
        if (keyframes == 40) break;
      }
    }
    if (fs::exists(out) || fs::exists(left / "map.cslam")) return;  // it was faster than the test
    const fs::path map = root / "recovered.cslam";
    good(root, "recover " + quoted(left) + " --out " + quoted(map));
    CHECK(read_text(map) == read_text(root / "whole/map.cslam"));
    fs::rename(root / "first/map.cslam", root / "moved.cslam");
    const std::string again = "recover " + quoted(left) + " --out " + quoted(root / "again.cslam");
    const ProgramResult gone = run_program(root, again);
    CHECK(gone.exit_code == 3);
    CHECK(contains(gone.errors, "which is not there any more"));
    save_map(root / "first/map.cslam", random_map(1, 5));
    CHECK(contains(run_program(root, again).errors, "which is another map now"));
    CHECK(!fs::exists(root / "again.cslam"));
    // What the back end had of it; it may not have come to its first keyframe.
    Index closed = 0;
    try_reading(
        [&] { closed = to_index(load_map(left / "map.cslam.partial", {.recover = true}).map.keyframes.size()); });
    const ProgramResult at_once = run_program(root, again + " --no-replay");
    CAPTURE(at_once.errors);
    CHECK(at_once.exit_code == (closed > 0 ? 0 : 3));
    if (closed > 0)
      CHECK(to_index(load_map(root / "again.cslam").map.keyframes.size()) == closed);
    else
      CHECK(contains(at_once.errors, "do: recover without --no-replay"));
  }

  TEST_CASE("saving and exporting that are killed at any moment leave the old file or the new one") {
    const ScratchFolder scratch("kill_save");
    const fs::path root = scratch.path(), map = root / "a.cslam", result = root / "result";
    save_map(map, random_map(1, 150, 2000));
    const std::vector<std::vector<std::string>> verbs = {
        {"recover", map.string(), "--out", result.string(), "--overwrite"},
        {"export", map.string(), "--format", "g2o", "--out", result.string(), "--overwrite"},
        {"export", map.string(), "--format", "ply", "--out", result.string(), "--overwrite"}};
    Rng rng(3);
    const int kills = full() ? 60 : 9;
    for (int i = 0; i < kills; ++i) {
      const std::vector<std::string>& verb = verbs[static_cast<std::size_t>(i) % verbs.size()];
      CAPTURE(i);
      fs::remove(result);
      const auto begin = Clock::now();
      CHECK(Running(verb, root / "errors").wait() == 0);
      const double whole_run = seconds_since(begin);
      const std::string fresh = read_text(result);
      write_text(result, "mine");
      {
        Running run(verb, root / "errors");
        sleep_for(rng.uniform(0, 1.2 * whole_run));
        run.signal(SIGKILL);
        static_cast<void>(run.wait());
      }
      const std::string found = read_text(result);
      CHECK((found == "mine" || found == fresh));
      if (found == fresh) CHECK(read_text(result.string() + "~1") == "mine");
      for (const auto& entry : fs::directory_iterator(root))
        if (contains(entry.path().filename().string(), "result")) fs::remove(entry.path());
    }
  }
}
