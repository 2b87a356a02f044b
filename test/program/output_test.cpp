#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <set>
#include <string>

#include "chainslam/io/map_archive.hpp"
#include "io/maps.hpp"
#include "program/faults.hpp"
#include "program/keyframe_data.hpp"
#include "program/run_program.hpp"

#include <doctest/doctest.h>

namespace {

using namespace chainslam;
using namespace chainslam::test;

std::string map_command(const fs::path& data, const fs::path& out) {
  return "map " + quoted(data) + " --out " + quoted(out);
}

}  // namespace

TEST_SUITE("program/output") {
  TEST_CASE("whichever result meets a full disk, the map is saved and so is every other result") {
    const ScratchFolder scratch("output_full");
    const fs::path data = scratch.path() / "data";
    write_keyframes(data, 6);
    const fs::path whole = scratch.path() / "whole";
    REQUIRE(run_program(scratch.path(), map_command(data, whole)).exit_code == 0);
    const std::set<std::string> all = names_in(whole);
    CHECK(all.size() > 10);
    int number = 0;
    for (const std::string& name : all) {
      if (name == "map.cslam" || (!full() && number++ % 3 != 0 && name != "report.html")) continue;
      CAPTURE(name);
      const fs::path out = scratch.path() / "out";
      const ProgramResult result =
          run_program(scratch.path(), map_command(data, out), with_fault("write:/" + name + ":28:0:stay"));
      CAPTURE(result.errors);
      CHECK(result.exit_code == 4);
      CHECK(three_lines(result.errors));
      CHECK(contains(result.errors, name));
      REQUIRE(fs::exists(out / "map.cslam"));
      CHECK(read_text(out / "map.cslam") == read_text(whole / "map.cslam"));
      std::set<std::string> others = all;
      others.erase(name);
      CHECK(names_in(out) == others);
      fs::remove_all(out);
    }
  }

  TEST_CASE("a map that meets a full disk leaves the old results, and what was committed") {
    const ScratchFolder scratch("output_map");
    const fs::path data = scratch.path() / "data", out = scratch.path() / "out";
    write_keyframes(data, 6);
    REQUIRE(run_program(scratch.path(), map_command(data, out)).exit_code == 0);
    const std::string before = read_text(out / "map.cslam");
    for (const char* fault :
         {"sync:map.cslam:5:2", "rename:/map.cslam:5:0", "rename:/out:28:2:stay", "sync:out.partial:5:0"}) {
      CAPTURE(std::string(fault));
      const ProgramResult result =
          run_program(scratch.path(), map_command(data, out) + " --overwrite", with_fault(fault));
      CAPTURE(result.errors);
      CHECK(result.exit_code == 4);
      CHECK(three_lines(result.errors));
      CHECK(read_text(out / "map.cslam") == before);
      CHECK(!fs::exists(scratch.path() / "out~1"));
    }
    int whole = 0;  // whose name alone failed
    for (const std::string& name : names_in(scratch.path()))
      if (contains(name, "out.partial") && fs::exists(scratch.path() / name / "map.cslam"))
        whole += load_map(scratch.path() / name / "map.cslam").map.keyframes.size() == 6;
    CHECK(whole >= 1);
  }

  TEST_CASE("results go where a symbolic link leads, and nothing that was there is deleted") {
    const ScratchFolder scratch("output_link");
    const fs::path data = scratch.path() / "data", real = scratch.path() / "real", link = scratch.path() / "link";
    write_keyframes(data, 3);
    fs::create_directory(real);
    fs::create_symlink("real", link);
    REQUIRE(run_program(scratch.path(), map_command(data, link)).exit_code == 0);
    CHECK(fs::is_symlink(link));
    CHECK(load_map(real / "map.cslam").map.keyframes.size() == 3);
    write_text(real / "precious.txt", "mine");
    CHECK(run_program(scratch.path(), map_command(data, link)).exit_code == 4);
    CHECK(run_program(scratch.path(), map_command(data, link) + " --overwrite").exit_code == 0);
    CHECK(fs::is_symlink(link));
    CHECK(read_text(scratch.path() / "real~1/precious.txt") == "mine");
    CHECK(fs::exists(real / "map.cslam"));
    fs::remove_all(real);
    CHECK(run_program(scratch.path(), map_command(data, link)).exit_code == 0);  // a link that leads nowhere yet
    CHECK(fs::exists(real / "map.cslam"));
  }

  TEST_CASE("no verb replaces a file, and --overwrite keeps the old one") {
    const ScratchFolder scratch("output_refuse");
    const fs::path map = scratch.path() / "a.cslam", result = scratch.path() / "result",
                   truth = scratch.path() / "truth.tum", graph = scratch.path() / "graph.g2o";
    save_map(map, random_map(1, 12));
    write_text(truth, "1 0 0 0 0 0 0 1\n2 1 0 0 0 0 0 1\n3 1 1 0 0 0 0 1\n4 2 1 1 0 0 0 1\n");
    write_text(graph, "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n");
    const std::string out = quoted(result);
    for (const std::string& command :
         {"optimize " + quoted(graph) + " --out " + out,
          "eval " + quoted(truth) + " " + quoted(truth) + " --json " + out,
          "export " + quoted(map) + " --format g2o --out " + out,
          "export " + quoted(map) + " --format ply --out " + out,
          "export " + quoted(map) + " --format tum --out " + out, "recover " + quoted(map) + " --out " + out,
          "simulate town --size small --out " + out}) {
      CAPTURE(command);
      write_text(result, "mine");
      const ProgramResult refused = run_program(scratch.path(), command);
      CHECK(refused.exit_code == 4);
      CHECK(three_lines(refused.errors));
      CHECK(contains(refused.errors, "--overwrite"));
      CHECK(read_text(result) == "mine");
      if (contains(command, "simulate")) continue;
      const ProgramResult kept = run_program(scratch.path(), command + " --overwrite");
      CAPTURE(kept.errors);
      CHECK(kept.exit_code == 0);
      CHECK(read_text(result.string() + "~1") == "mine");
      CHECK((fs::is_directory(result) || read_text(result) != "mine"));
      for (const char* name : {"result", "result~1"}) fs::remove_all(scratch.path() / name);
    }
    fs::remove(result);
    CHECK(names_in(scratch.path()) ==
          std::set<std::string>{"a.cslam", "graph.g2o", "truth.tum", "stdout.txt", "stderr.txt"});
  }

  TEST_CASE("what cannot be written is 4 for every verb, the old file stays and nothing else is left") {
    const ScratchFolder scratch("output_verbs");
    const fs::path map = scratch.path() / "a.cslam", result = scratch.path() / "result",
                   truth = scratch.path() / "truth.tum", graph = scratch.path() / "graph.g2o";
    save_map(map, random_map(1, 12));
    write_text(truth, "1 0 0 0 0 0 0 1\n2 1 0 0 0 0 0 1\n3 1 1 0 0 0 0 1\n4 2 1 1 0 0 0 1\n");
    write_text(graph, "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n");
    const std::string out = quoted(result) + " --overwrite";
    for (const std::string& command :
         {"optimize " + quoted(graph) + " --out " + out,
          "eval " + quoted(truth) + " " + quoted(truth) + " --json " + out,
          "export " + quoted(map) + " --format g2o --out " + out,
          "export " + quoted(map) + " --format pcd --out " + out, "recover " + quoted(map) + " --out " + out})
      for (const char* fault : {"create:result:28:0", "write:result:28:0:stay", "write:result:122:0:stay",
                                "sync:result:5:0", "rename:result:5:0", "rename:/result:30:0:stay"}) {
        CAPTURE(command);
        CAPTURE(std::string(fault));
        write_text(result, "mine");
        const fs::path log = scratch.path() / "log";
        const ProgramResult failed = run_program(scratch.path(), command, with_fault(fault, log));
        CAPTURE(failed.errors);
        CHECK(fs::exists(log));
        CHECK(failed.exit_code == 4);
        CHECK(three_lines(failed.errors));
        CHECK(read_text(result) == "mine");
        fs::remove(log);
        for (const std::string& name : names_in(scratch.path()))
          if (contains(name, "result.partial")) {
            CHECK(contains(command, "recover"));  // the copy is whole and synced: only its name failed
            CHECK(load_map(scratch.path() / name, {.recover = true}).map.keyframes.size() == 12);
            fs::remove(scratch.path() / name);
          }
        CHECK(!fs::exists(result.string() + "~1"));
      }
  }

  TEST_CASE("interrupted writes and short ones are done again") {
    const ScratchFolder scratch("output_again");
    const fs::path map = scratch.path() / "a.cslam";
    save_map(map, random_map(1, 12));
    int runs = 0;
    for (const char* fault : {"write:result:4:0", "write:result:0:0", "sync:result:4:0", "create:result:4:0",
                              "rename:result:4:0", "read:a.cslam:4:1"}) {
      CAPTURE(std::string(fault));
      const fs::path result = scratch.path() / ("result" + std::to_string(runs++)), log = scratch.path() / "log";
      const ProgramResult done =
          run_program(scratch.path(), "recover " + quoted(map) + " --out " + quoted(result), with_fault(fault, log));
      CAPTURE(done.errors);
      CHECK(fs::exists(log));
      CHECK(done.exit_code == 0);
      CHECK(read_text(result) == read_text(map));
      fs::remove(log);
    }
  }
}
