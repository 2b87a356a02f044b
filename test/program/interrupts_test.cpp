#include <sys/stat.h>

#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/io/map_archive.hpp"
#include "io/maps.hpp"
#include "program/faults.hpp"
#include "program/keyframe_data.hpp"
#include "program/running.hpp"

#include <doctest/doctest.h>

namespace {

using namespace chainslam;
using namespace chainslam::test;

/// A trajectory as TUM writes it that winds, with a pose each 0.1 s.
std::string winding(int poses) {
  std::string text;
  for (int i = 0; i < poses; ++i) {
    const double t = 0.1 * i, yaw = 0.6 * std::sin(0.01 * t);
    char line[128];
    std::snprintf(line, sizeof line, "%.1f %.6f %.6f 0 0 0 %.9f %.9f\n", 1000 + t, 6 * t, 40 * std::sin(0.02 * t),
                  std::sin(yaw / 2), std::cos(yaw / 2));
    text += line;
  }
  return text;
}

/// A pose graph of a grid whose rows and columns are joined; wrong enough for many iterations.
std::string grid_graph(int side) {
  std::string text;
  const auto id = [&](int x, int y) { return std::to_string(x + side * y); };
  const std::string information = " 1 0 0 1 0 1\n";
  for (int y = 0; y < side; ++y)
    for (int x = 0; x < side; ++x) {
      text += "VERTEX_SE2 " + id(x, y) + ' ' + std::to_string(1.1 * x) + ' ' + std::to_string(0.9 * y) + " 0.1\n";
      if (x > 0) text += "EDGE_SE2 " + id(x - 1, y) + ' ' + id(x, y) + " 1 0 0.01" + information;
      if (y > 0) text += "EDGE_SE2 " + id(x, y - 1) + ' ' + id(x, y) + " 0 1 -0.01" + information;
    }
  return text;
}

/// A program that was interrupted: what it had said by then, and how it ended.
struct Ended {
  double reacted = 0;             ///< seconds until it ended, or said that it finishes
  std::optional<double> stopped;  ///< where it had only said so: from the second signal on
  int code = -1;
};

Ended interrupt(const std::vector<std::string>& command, double wait, int number, const fs::path& errors) {
  Running run(command, errors);
  sleep_for(wait);
  run.signal(number);
  Ended ended;
  std::optional<int> code;
  auto begin = Clock::now();
  do {
    code = run.wait_for(0.05);
    ended.reacted = seconds_since(begin);
  } while (!code && ended.reacted < hung && !contains(read_text(errors), "finishing"));
  if (!code) {
    run.signal(number);
    begin = Clock::now();
    code = run.wait_for(hung);
    ended.stopped = seconds_since(begin);
  }
  ended.code = code.value_or(-1);
  return ended;
}

}  // namespace

TEST_SUITE("program/interrupts") {
  TEST_CASE("every verb reacts to Ctrl-C within a second while it computes, and the second one ends it at once") {
    const ScratchFolder scratch("interrupts");
    const fs::path root = scratch.path(), result = root / "result", errors = root / "errors";
    write_text(root / "long.tum", winding(60'000));
    write_text(root / "drive.tum", winding(6'000));
    write_text(root / "grid.g2o", grid_graph(150));
    write_keyframes(root / "data", 160, true);
    static_cast<void>(run_program(root, "map " + quoted(root / "data") + " --out " + quoted(root / "killed"),
                                  with_fault("sync:input.cslam:-1:13")));
    REQUIRE(fs::exists(root / "killed.partial"));
    const std::string out = result.string(), tum = (root / "long.tum").string();
    const std::vector<std::vector<std::string>> verbs = {
        {"map", "simulate:nclt-like/medium/1", "--out", out},
        {"odometry", "simulate:nclt-like/medium/1", "--out", out},
        {"simulate", "nclt-like", "--out", out},
        {"simulate", "--trajectory", (root / "drive.tum").string(), "--out", out},
        {"recover", (root / "killed.partial").string(), "--out", out},
        {"eval", tum, tum, "--json", out, "--pairs", "all", "--delta", "1000m"},
        {"optimize", (root / "grid.g2o").string(), "--out", out}};
    std::vector<double> reacted, stopped;
    int while_computing = 0, finishing = 0;
    for (std::size_t i = 0; i < verbs.size(); ++i)
      for (const double wait : {0.05, 0.3, 1.0}) {
        const std::vector<std::string>& verb = verbs[i];
        if (!full() && wait != (verb.front() == "recover" ? 0.05 : i < 2 ? 1.0 : 0.3)) continue;
        CAPTURE(verb.front());
        CAPTURE(wait);
        const Ended ended = interrupt(verb, wait, wait == 0.3 ? SIGTERM : SIGINT, errors);
        CHECK(ended.reacted < hung);
        reacted.push_back(ended.reacted);
        if (ended.stopped) stopped.push_back(*ended.stopped);
        CHECK((ended.code == 130 || ended.code == 0 || (wait == 0.3 && ended.code == 128 + SIGTERM)));
        while_computing += ended.code != 0;
        finishing += contains(read_text(errors), "finishing");
        if (ended.code != 0 && verb.front() != "map" && verb.front() != "odometry") CHECK(!fs::exists(result));
        for (const std::string& name : names_in(root))
          if (name.starts_with("result")) fs::remove_all(root / name);
      }
    CHECK(while_computing >= (full() ? 14 : 6));
    CHECK(finishing >= 1);
    REQUIRE(!stopped.empty());
    CHECK(mostly_within_a_second(reacted));
    CHECK(mostly_within_a_second(stopped));
  }

  TEST_CASE("every verb ends within a second of a signal while it waits for a pipe that nobody writes") {
    const ScratchFolder scratch("pipes");
    const fs::path root = scratch.path(), pipe = root / "pipe", result = root / "result", errors = root / "errors";
    REQUIRE(::mkfifo(pipe.c_str(), 0600) == 0);
    write_text(root / "a.tum", winding(20));
    write_keyframes(root / "data", 2, false, 5, 20);
    const std::string in = pipe.string(), out = result.string(), tum = (root / "a.tum").string(),
                      data = (root / "data").string();
    const std::vector<std::vector<std::string>> verbs = {{"map", data, "--load", in, "--out", out},
                                                         {"map", data, "--truth", in, "--out", out},
                                                         {"map", data, "--config", in, "--out", out},
                                                         {"odometry", data, "--config", in, "--out", out},
                                                         {"simulate", "--trajectory", in, "--out", out},
                                                         {"inspect", in},
                                                         {"check", in},
                                                         {"recover", in, "--out", out},
                                                         {"undo", in, "--session", "0", "--out", out},
                                                         {"merge", in, in, "--out", out},
                                                         {"report", in, "--out", out},
                                                         {"export", in, "--format", "tum", "--out", out},
                                                         {"eval", tum, in},
                                                         {"optimize", in, "--out", out},
                                                         {"config", "--check", in}};
    std::vector<double> waited;
    for (std::size_t i = 0; i < verbs.size(); ++i) {
      CAPTURE(verbs[i].front());
      const int number = i % 3 == 0 ? SIGINT : i % 3 == 1 ? SIGTERM : SIGHUP;
      Running run(verbs[i], errors);
      const std::optional<int> early = run.wait_for(0.08);
      if (early) {  // it refuses pipes
        CAPTURE(read_text(errors));
        CHECK((*early == 2 || *early == 3));
        continue;
      }
      run.signal(number);
      const auto begin = Clock::now();
      const std::optional<int> code = run.wait_for(hung);
      const double seconds = seconds_since(begin);
      REQUIRE(code);
      CHECK(!fs::exists(result));
      CHECK(!fs::exists(out + ".partial"));
      if (*code == 2 || *code == 3) continue;  // it refuses pipes, and had not come to it
      CHECK((*code == 130 || *code == 128 + number));
      waited.push_back(seconds);
    }
    REQUIRE(waited.size() >= 6);
    CHECK(mostly_within_a_second(waited));
  }

  TEST_CASE("what was begun of results is gone, whatever operation a signal ends the program in") {
    const ScratchFolder scratch("begun");
    const fs::path root = scratch.path(), map = root / "a.cslam", result = root / "result";
    save_map(map, random_map(2, 12));
    const std::vector<std::pair<std::vector<std::string>, std::string>> verbs = {
        {{"export", map.string(), "--format", "tum", "--out", result.string()}, "create:joint:-2:0"},
        {{"export", map.string(), "--format", "kitti", "--out", result.string()}, "sync:session_0:-2:0"},
        {{"export", map.string(), "--format", "pcd", "--out", result.string()}, "sync:result:-2:0"},
        {{"export", map.string(), "--format", "g2o", "--out", result.string()}, "write:result:-2:0"},
        {{"recover", map.string(), "--out", result.string()}, "write:result:-2:0"},
        {{"undo", map.string(), "--session", "0", "--out", result.string()}, "write:result:-2:0"},
        {{"merge", map.string(), map.string(), "--out", result.string()}, "write:result:-2:0"},
        {{"report", map.string(), "--out", result.string()}, "sync:map.ply:-2:0"}};
    for (const auto& one : verbs) {
      const std::string& fault = one.second;
      CAPTURE(fault);
      ::setenv("LD_PRELOAD", CHAINSLAM_FAULTS, 1);
      ::setenv("CHAINSLAM_FAULT", fault.c_str(), 1);
      Running run(one.first, root / "errors");
      ::unsetenv("LD_PRELOAD");
      ::unsetenv("CHAINSLAM_FAULT");
      REQUIRE(!run.wait_for(0.4));  // it is in that operation
      run.signal(SIGINT);
      const std::optional<int> code = run.wait_for(hung);
      REQUIRE(code);
      // The signal also ends the wait: what took that moment to become whole may stay, whole, and the program end well.
      CHECK((*code == 130 || (*code == 0 && fs::exists(result))));
      if (const std::string& verb = one.first.front();
          (verb == "recover" || verb == "undo" || verb == "merge") && fs::exists(result)) {
        CHECK((load_map(result).map.keyframes.size() == load_map(map).map.keyframes.size()) == (verb != "undo"));
        fs::remove(result);
      }
      CHECK(names_in(root) == std::set<std::string>{"a.cslam", "errors"});
    }
  }
}
