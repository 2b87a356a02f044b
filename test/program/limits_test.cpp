#include <unistd.h>

#include <cmath>
#include <csignal>
#include <string>
#include <vector>

#include "chainslam/io/input_journal.hpp"
#include "chainslam/io/map_archive.hpp"
#include "io/maps.hpp"
#include "program/faults.hpp"
#include "program/keyframe_data.hpp"
#include "program/running.hpp"

#include <doctest/doctest.h>

namespace {

using namespace chainslam;
using namespace chainslam::test;

/// The memory in use that a run's last progress line states, MiB.
double last_memory(const std::string& progress) {
  const std::size_t end = progress.rfind(" MiB");
  REQUIRE(end != std::string::npos);
  return std::stod(progress.substr(progress.rfind(' ', end - 1)));
}

/// A bound that a run keeps to at its start and not at its end, megabytes. @param start, end  of its memory, MiB
int between(double start, double end) {
  REQUIRE(end > start + 3);
  return static_cast<int>(std::lround(1.048576 * (start + end) / 2));
}

/// Waits until a run has acknowledged so many keyframes.
void await_keyframes(const fs::path& left, Index count) {
  for (int i = 0; i < 2000; ++i) {
    sleep_for(0.003);
    try {
      if (read_input_journal(left / "input.cslam.partial").keyframes >= count) return;
    } catch (const IoError&) {  // it is not there yet
    }
  }
}

}  // namespace

TEST_SUITE("program/limits") {
  TEST_CASE("a run that needs more memory than it may ends in order: the map is saved, exit code 4") {
    const ScratchFolder scratch("limits_memory");
    const fs::path data = scratch.path() / "data", out = scratch.path() / "out";
    write_keyframes(data, 36, false, 5, 1500);
    const std::string command = "map " + quoted(data) + " --set keyframes.voxel_size=0 --threads 1 --out ";
    const auto memory_of = [&](const std::string& scans) {
      return last_memory(
          run_program(scratch.path(), command + quoted(scratch.path() / scans) + " --max-scans " + scans).errors);
    };
    const int megabytes = between(memory_of("1"), memory_of("36"));
    const std::string number = std::to_string(megabytes), bound = number + " MB";
    const ProgramResult full = run_program(scratch.path(), command + quoted(out) + " --max-memory " + number + "MB");
    CAPTURE(full.errors);
    CHECK(full.exit_code == 4);
    CHECK(contains(full.errors, "more than " + bound + " in use (--max-memory)"));
    const auto keyframes = load_map(out / "map.cslam").map.keyframes.size();
    CHECK(keyframes > 0);
    CHECK(keyframes < 36);
    CHECK(fs::exists(out / "trajectory.tum"));
    // By default, it may have half of the machine's memory.
    const std::string small_machine = "LD_PRELOAD=" CHAINSLAM_FAULTS " CHAINSLAM_MACHINE_PAGES=" +
                                      std::to_string(2'000'000L * megabytes / ::sysconf(_SC_PAGESIZE));
    const ProgramResult half = run_program(scratch.path(), command + quoted(scratch.path() / "half"), small_machine);
    CHECK(half.exit_code == 4);
    CHECK(contains(half.errors, "more than " + bound + " in use (--max-memory)"));
    CHECK(load_map(scratch.path() / "half/map.cslam").map.keyframes.size() > 0);
    const ProgramResult none =
        run_program(scratch.path(), command + quoted(scratch.path() / "no") + " --max-memory 1MB");
    CHECK(none.exit_code == 4);
    CHECK(three_lines(none.errors));
    CHECK(!fs::exists(scratch.path() / "no"));
    CHECK(!fs::exists(scratch.path() / "no.partial"));
    save_map(scratch.path() / "many.cslam", random_map(1, 9000));
    const ProgramResult load =
        run_program(scratch.path(), command + quoted(scratch.path() / "no") + " --load " +
                                        quoted(scratch.path() / "many.cslam") + " --max-memory 2MB");
    CHECK(load.exit_code == 3);
    CHECK(contains(load.errors, "bytes of memory, where 2000000 are allowed"));
    CHECK(!fs::exists(scratch.path() / "no.partial"));
  }

  TEST_CASE("odometry that needs more memory than it may ends in order: what came before is recorded, exit code 4") {
    const ScratchFolder scratch("limits_odometry");
    const fs::path set = scratch.path() / "set";
    const auto record = [&](const std::string& more) {
      fs::remove_all(set);
      return run_program(scratch.path(),
                         "odometry simulate:mars-like/small/1 --max-scans 80 --threads 1 --out " + quoted(set) + more,
                         "LD_PRELOAD=" CHAINSLAM_FAULTS " CHAINSLAM_FILE_MEGABYTES=20");
    };
    const std::string bound = "110";  // three files of the set, and some scans after them
    const ProgramResult full = record(" --max-memory " + bound + "MB");
    CAPTURE(full.errors);
    CHECK(full.exit_code == 4);
    CHECK(three_lines(full.errors));
    CHECK(contains(full.errors,
                   "more than " + bound + " MB in use (--max-memory)\n  do: the results so far are recorded"));
    CHECK(contains(full.output, "recorded     " + set.string()));
    const auto frames = nlohmann::json::parse(read_text(set / "odometry.json"))["frames"].get<int>();
    CHECK(frames > 1);
    CHECK(frames < 80);
    CHECK(run_program(scratch.path(), "map " + quoted(set) + " --out " + quoted(scratch.path() / "map")).exit_code ==
          0);
    const ProgramResult none = record(" --max-memory 1MB");
    CHECK(none.exit_code == 4);
    CHECK(three_lines(none.errors));
    CHECK(contains(none.errors, "more than 1 MB in use (--max-memory)"));
    CHECK(!fs::exists(set));
    CHECK(!fs::exists(set.string() + ".partial"));
  }

  TEST_CASE("Ctrl-C, SIGTERM and SIGHUP end a run with its map saved; the second signal ends it at once") {
    const ScratchFolder scratch("limits_signals");
    const fs::path data = scratch.path() / "data", out = scratch.path() / "out", left = scratch.path() / "out.partial";
    write_keyframes(data, 150, true);
    const std::vector<std::string> command{"map", data.string(), "--out", out.string(), "--threads", "1"};
    for (const int number : {SIGINT, SIGTERM, SIGHUP}) {
      CAPTURE(number);
      Running run(command, scratch.path() / "errors");
      await_keyframes(left, 5);
      run.signal(number);
      const int code = run.wait();
      CHECK((code == 130 || (code == 0 && load_map(out / "map.cslam").map.keyframes.size() == 150)));
      CHECK(load_map(out / "map.cslam").map.keyframes.size() >= 5);
      CHECK(fs::exists(out / "trajectory.tum"));
      fs::remove_all(out);
    }
    {
      Running run(command, scratch.path() / "errors");
      await_keyframes(left, 5);
      run.signal(SIGINT);
      sleep_for(0.01);
      run.signal(SIGINT);
      CHECK(run.wait_for(hung) == 130);
    }
    if (fs::exists(out)) return;  // it had saved by then
    const fs::path map = scratch.path() / "recovered.cslam";
    CHECK(run_program(scratch.path(), "recover " + quoted(left) + " --out " + quoted(map)).exit_code == 0);
    CHECK(load_map(map).map.keyframes.size() >= 5);
  }

  TEST_CASE("every other verb ends within a second of Ctrl-C, and leaves nothing half-written") {
    const ScratchFolder scratch("limits_verbs");
    const fs::path map = scratch.path() / "a.cslam", result = scratch.path() / "result";
    save_map(map, random_map(1, 300, 3000));
    const std::vector<std::vector<std::string>> verbs = {
        {"recover", map.string(), "--out", result.string()},
        {"export", map.string(), "--format", "ply", "--out", result.string()},
        {"report", map.string(), "--out", result.string()},
        {"check", map.string()},
        {"inspect", map.string()},
        {"simulate", "town", "--out", result.string()}};
    std::vector<double> waited;
    for (const std::vector<std::string>& verb : verbs)
      for (const double wait : {0.02, 0.1, 0.4}) {
        CAPTURE(verb.front());
        CAPTURE(wait);
        Running run(verb, scratch.path() / "errors");
        sleep_for(wait);
        run.signal(SIGINT);
        const auto begin = Clock::now();
        const std::optional<int> code = run.wait_for(hung);
        waited.push_back(seconds_since(begin));
        CHECK((code == 0 || code == 130));  // 128 + SIGINT: it had nothing to tidy up
        if (code == 130 && fs::exists(result)) CHECK(verb.front() != "simulate");  // a file that has its name is whole
        fs::remove_all(result);
        for (const auto& entry : fs::directory_iterator(scratch.path()))
          CHECK_MESSAGE(!contains(entry.path().filename().string(), "result"), entry.path().string());
      }
    CHECK(mostly_within_a_second(waited));
  }

  TEST_CASE("a limit on file sizes, no inodes and a full or closed output are errors like others") {
    const ScratchFolder scratch("limits_files");
    const fs::path data = scratch.path() / "data", out = scratch.path() / "out", map = scratch.path() / "a.cslam";
    write_keyframes(data, 6);
    save_map(map, random_map(1, 12));
    const std::string command = "map " + quoted(data) + " --out " + quoted(out);
    const ProgramResult limited =
        run_program(scratch.path(), command, "ulimit -f 24;");  // SIGXFSZ kills who does not expect it
    CHECK(limited.exit_code == 4);
    CHECK(three_lines(limited.errors));
    CHECK(contains(limited.errors, "ulimit -f"));
    for (const char* fault : {"mkdir:out.partial:28:0", "create:writable:28:0", "create:input.cslam:28:0"}) {
      CAPTURE(std::string(fault));
      const ProgramResult none = run_program(
          scratch.path(), command, "LD_PRELOAD=" CHAINSLAM_FAULTS " CHAINSLAM_FAULT='" + std::string(fault) + "'");
      CHECK(none.exit_code == 4);
      CHECK(three_lines(none.errors));
      CHECK(!fs::exists(out));
    }
    const auto shell = [&](const std::string& line) {
      return WEXITSTATUS(std::system(("bash -c '" + line + "' 2>/dev/null").c_str()));
    };
    const std::string program = CHAINSLAM_PROGRAM, inspect = program + " inspect " + map.string() + " --closures";
    CHECK(shell(inspect + " >/dev/full") == 4);
    CHECK(shell(inspect + " | true; exit ${PIPESTATUS[0]}") == 0);
    CHECK(shell(program + " recover " + map.string() + " --out " + out.string() + " >&- 2>&- <&-") == 0);
    CHECK(read_text(out) == read_text(map));  // what was printed went nowhere, not into the map
  }

  TEST_CASE("a wrong command line is 2, in three lines") {
    const ScratchFolder scratch("limits_usage");
    for (const char* arguments :
         {"", "mpa x", "map", "map x --out", "map x --out y --threads 0", "map x --out y --no-such",
          "map x --out y --max-memory much", "eval a", "eval a b c", "eval a b --align round",
          "eval a b --delta 3miles", "export m --format e57 --out x", "optimize", "recover m", "config",
          "simulate nowhere --out y", "simulate --out y", "simulate town --sessions 9 --out y"}) {
      CAPTURE(arguments);
      const ProgramResult result = run_program(scratch.path(), arguments);
      CAPTURE(result.errors);
      CHECK(result.exit_code == 2);
      CHECK(three_lines(result.errors));
    }
    write_keyframes(scratch.path() / "data", 2);
    const ProgramResult truths = run_program(scratch.path(), "map " + quoted(scratch.path() / "data") + " --out " +
                                                                 quoted(scratch.path() / "y") + " --truth a b");
    CHECK(truths.exit_code == 2);
    CHECK(contains(truths.errors, "2 files for 1 data sets"));
    CHECK(!fs::exists(scratch.path() / "y"));
  }
}
