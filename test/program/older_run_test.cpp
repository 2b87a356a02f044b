#include <cstdio>
#include <string>

#include "chainslam/io/input_journal.hpp"
#include "chainslam/io/map_archive.hpp"
#include "program/faults.hpp"
#include "program/keyframe_data.hpp"

#include <doctest/doctest.h>

// A robot is updated between a crash and the recovery: the run's settings are another version's.

namespace {

using namespace chainslam;
using namespace chainslam::test;

/// What a run leaves that is cut off before its map is saved.
JournaledInput unfinished_run(const fs::path& root) {
  write_keyframes(root / "data", 60, true);
  static_cast<void>(run_program(root, "map " + quoted(root / "data") + " --threads 1 --out " + quoted(root / "run"),
                                with_fault("sync:input.cslam:-1:6")));
  return read_input_journal(root / "run.partial/input.cslam.partial");
}

/// The same as if the run had had these settings.
void write_journal(const fs::path& folder, const JournaledInput& run, const std::string& settings) {
  fs::create_directories(folder);
  fs::remove(folder / "input.cslam.partial");
  InputJournal journal(folder / "input.cslam", settings, run.loaded);
  for (const MapInput& input : run.inputs) journal.append(input);
  journal.commit();
}

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const std::size_t at = text.find(from);
  REQUIRE(at != std::string::npos);
  return text.replace(at, from.size(), to);
}

}  // namespace

TEST_SUITE("program/older run") {
  TEST_CASE("recover closes a run's loops again that another version began, and says which settings it left out") {
    const ScratchFolder scratch("older_run");
    const fs::path root = scratch.path();
    const JournaledInput run = unfinished_run(root);
    REQUIRE(run.keyframes > 20);
    const auto recover = [&](const fs::path& from, const fs::path& to) {
      return run_program(root, "recover " + quoted(from) + " --threads 1 --out " + quoted(to));
    };
    const fs::path map = root / "map.cslam";
    const ProgramResult own = recover(root / "run.partial", map);
    REQUIRE(own.exit_code == 0);
    CHECK(!contains(own.errors, "another version"));
    CHECK(!load_map(map).map.closures.empty());

    // Settings that are gone, of a table and a whole table, and a choice that is gone: the map is the same.
    std::string older = replaced(run.parameters, "[merge]\n", "[merge]\nrefine = true\nfast_for = [1, 2]\n");
    older = replaced(older, "source = \"lidar_inertial\"", "source = \"wheels\"");
    write_journal(root / "older.partial", run, older + "\n[submaps.shape]\nedge = 3.5\nname = \"a\\nb\"\n");
    const std::string before = read_text(root / "older.partial/input.cslam.partial");
    const ProgramResult result = recover(root / "older.partial", root / "older.cslam");
    CAPTURE(result.errors);
    CHECK(result.exit_code == 0);
    CHECK(
        contains(result.errors, "note: another version of chainslam began this run: its own map may have differed\n"));
    for (const char* left_out : {"merge.refine = true", "merge.fast_for = [1, 2]", "odometry.source = \"wheels\"",
                                 "submaps.shape.edge = 3.5", "submaps.shape.name = \"a"})
      CHECK_MESSAGE(contains(result.errors, left_out), left_out);
    CHECK(contains(result.output, std::to_string(run.keyframes) + " keyframes of the run, all that it had shown"));
    CHECK(read_text(root / "older.cslam") == read_text(map));
    CHECK(read_text(root / "older.partial/input.cslam.partial") == before);

    // What it does state holds, and what it does not is this version's default, with which the map says it was made.
    std::string sparse = replaced(run.parameters, "\nradius = 15.0\n", "\nradius = 0.5\n");
    const std::size_t line = sparse.find("\nmin_travel = ");
    REQUIRE(line != std::string::npos);
    sparse.erase(line, sparse.find('\n', line + 1) - line);
    write_journal(root / "sparse.partial", run, sparse);
    const ProgramResult other = recover(root / "sparse.partial", root / "sparse.cslam");
    CAPTURE(other.errors);
    CHECK(other.exit_code == 0);
    CHECK(contains(other.errors, "does not state, at their defaults: closures.min_travel\n"));
    CHECK(!contains(other.errors, "left out"));
    const LoadedMap made = load_map(root / "sparse.cslam");
    CHECK(to_index(made.map.keyframes.size()) == run.keyframes);
    CHECK(made.map.closures.size() < load_map(map).map.closures.size());
    CHECK(contains(made.parameters, "\nmin_travel = "));
    CHECK(contains(made.parameters, "\nradius = 0.5\n"));
  }

  TEST_CASE("of a run whose settings cannot be read at all, recover names what helps, and that does") {
    const ScratchFolder scratch("foreign_run");
    const fs::path root = scratch.path();
    const JournaledInput run = unfinished_run(root);
    write_journal(root / "run.partial", run, "<settings/>\n");
    const std::string recover = "recover " + quoted(root / "run.partial") + " --out " + quoted(root / "map.cslam");
    const ProgramResult refused = run_program(root, recover);
    CAPTURE(refused.errors);
    CHECK(refused.exit_code == 3);
    CHECK(three_lines(refused.errors));
    CHECK(contains(refused.errors, "a configuration that this version cannot use: parameters, line 1"));
    CHECK(contains(refused.errors, "or pass --no-replay"));
    CHECK(!fs::exists(root / "map.cslam"));
    CHECK(read_input_journal(root / "run.partial/input.cslam.partial").keyframes == run.keyframes);
    const ProgramResult at_once = run_program(root, recover + " --no-replay");
    if (contains(at_once.errors, "nothing that the run had closed")) return;  // it was cut off before
    CHECK(at_once.exit_code == 0);
    CHECK(load_map(root / "map.cslam").map.keyframes.size() > 0);
  }
}
