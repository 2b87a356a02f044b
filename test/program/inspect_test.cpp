#include <doctest/doctest.h>

#include <cstdio>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <vector>

#include "program/run_program.hpp"

// What `inspect` prints, for people and for programs, and how it reads times of points that the data leave open.

namespace {

using namespace chainslam::test;

ProgramResult inspected(const ScratchFolder& scratch, const fs::path& path, const std::string& options = "") {
  ProgramResult result = run_program(scratch.path(), "inspect " + quoted(path) + " " + options);
  CAPTURE(result.errors);
  CHECK(result.exit_code == 0);
  return result;
}

/// The lines of an output that are not empty, without the blanks before them.
std::vector<std::string> trimmed_lines(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream stream(text);
  for (std::string line; std::getline(stream, line);)
    if (const std::size_t first = line.find_first_not_of(' '); first != std::string::npos)
      lines.push_back(line.substr(first));
  return lines;
}

/// The value of a fact in the table; "(none)" if there is no such fact.
std::string fact(const std::string& output, const std::string& name) {
  for (const std::string& line : trimmed_lines(output))
    if (line.starts_with(name + "  ")) return line.substr(line.find_first_not_of(' ', name.size()));
  return "(none)";
}

/// Clouds of 200 points, whose times fall from point to point by 0.1 s in a scan, as where rings are stored backwards.
void write_falling_times(const fs::path& folder) {
  fs::create_directories(folder / "clouds");
  for (int scan = 0; scan < 3; ++scan) {
    std::string text =
        "VERSION 0.7\nFIELDS x y z time\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH 200\nHEIGHT 1\n"
        "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 200\nDATA ascii\n";
    for (int i = 0; i < 200; ++i) {
      char line[80];
      std::snprintf(line, sizeof line, "%.2f %.2f 1 %.4f\n", 5 + 0.1 * (i % 20), 0.1 * (i / 20), 0.1 * (199 - i) / 199);
      text += line;
    }
    write_text(folder / "clouds" / (std::to_string(scan) + ".pcd"), text);
  }
  write_text(folder / "times.txt", "1000.0\n1000.1\n1000.2\n");  // far from zero, so that times are relative
}

const char* const small_summary = R"({
  "verdict": {"good": true, "text": "good"},
  "sessions": [
    {"name": "monday", "keyframes": 12, "path_length_m": 513.9286092077974, "health": {"lost": 0, "intervals": []}},
    {"name": "tuesday morning", "keyframes": 7, "path_length_m": 0.30000000000000004, "notes": ["a", "b"],
     "health": {"lost": 3, "intervals": [{"frames": 2}, {"frames": 1}]}}],
  "components": {"histogram": []},
  "data_seconds": 30.000000000000004,
  "peak_memory_bytes": 421097472,
  "ratios": [0.5, 1.0, 2.0000000000000004],
  "notes": []
})";

}  // namespace

TEST_SUITE("program/inspect") {
  TEST_CASE("a run's folder is a table: numbers as people write them, a column for each session, no JSON") {
    const ScratchFolder scratch("inspect_table");
    const fs::path map = scratch.path() / "map";
    fs::create_directories(map);
    write_text(map / "summary.json", small_summary);
    const std::string output = inspected(scratch, map).output;
    CHECK(fact(output, "data_seconds") == "30");
    CHECK(fact(output, "peak_memory_bytes") == "421097472");
    CHECK(fact(output, "ratios") == "0.5, 1, 2");
    CHECK(fact(output, "verdict.good") == "true");
    CHECK(fact(output, "notes") == "none");
    CHECK(fact(output, "components.histogram") == "none");
    CHECK(fact(output, "sessions.name") == "monday   tuesday morning");
    CHECK(fact(output, "sessions.keyframes") == "12       7");
    CHECK(fact(output, "sessions.path_length_m") == "513.929  0.3");
    CHECK(fact(output, "sessions.health.lost") == "0        3");
    CHECK(fact(output, "sessions.health.intervals") == "none     2 entries");
    CHECK(fact(output, "sessions.notes") == "-        a, b");
    CHECK(!contains(output, "{"));
    CHECK(contains(output, "! graph.g2o is missing"));
  }

  TEST_CASE("with --json, the same for programs, and the summary as it is") {
    const ScratchFolder scratch("inspect_json");
    const fs::path map = scratch.path() / "map";
    fs::create_directories(map);
    write_text(map / "summary.json", small_summary);
    const auto json = nlohmann::json::parse(inspected(scratch, map, "--json").output);
    CHECK(json["path"] == map.string());
    CHECK(json["kind"] == "map made by chainslam");
    CHECK(json["summary"] == nlohmann::json::parse(small_summary));
    CHECK(json["warnings"].size() == 4);
    CHECK(json["facts"][0] == nlohmann::json{{"name", "verdict.good"}, {"value", "true"}});

    write_text(scratch.path() / "a.tum", "1 0 0 0 0 0 0 1\n2 1 0 0 0 0 0 1\n");
    const auto file = nlohmann::json::parse(inspected(scratch, scratch.path() / "a.tum", "--json").output);
    CHECK(file["kind"] == "TUM trajectory");
    CHECK(!file.contains("summary"));
    const ProgramResult closures = run_program(scratch.path(), "inspect " + quoted(map) + " --json --closures");
    CHECK(closures.exit_code == 3);
    CHECK(contains(closures.errors, "map.cslam"));
  }

  TEST_CASE("a list that is too long for a table is counted") {
    const ScratchFolder scratch("inspect_long");
    const fs::path map = scratch.path() / "map";
    fs::create_directories(map);
    nlohmann::json many;
    for (int i = 0; i < 41; ++i) many["sessions"].push_back({{"name", i}});
    write_text(map / "summary.json", many.dump());
    CHECK(fact(inspected(scratch, map).output, "sessions") == "41 entries");
    many["sessions"].erase(0);
    many["sessions"][0]["name"] = std::string(1000, 'x');
    write_text(map / "summary.json", many.dump());
    const std::string names = fact(inspected(scratch, map).output, "sessions.name");
    CHECK(names.starts_with(std::string(45, 'x') + "...  2  3"));
  }

  TEST_CASE("times of points that decrease are ambiguous until a setting states their direction") {
    const ScratchFolder scratch("point_times");
    const fs::path data = scratch.path() / "data";
    write_falling_times(data);
    const std::string open = inspected(scratch, data).output;
    CHECK(contains(open, "values from 0 to 0.1 fall from point to point"));
    CHECK(contains(open, "set dataset.point_time_unit, point_time_base or point_time_direction"));
    CHECK(fact(open, "sweep") == "(none)");

    const std::string backward = inspected(scratch, data, "--set dataset.point_time_direction=backward").output;
    CHECK(!contains(backward, "!"));
    CHECK(contains(backward, "counting back, stamp at the sweep's end"));
    CHECK(fact(backward, "sweep") == "points measured within up to 0.1 s");
    const std::string forward = inspected(scratch, data, "--set dataset.point_time_direction=forward").output;
    CHECK(!contains(forward, "counting back"));
    CHECK(contains(forward, "stamp at the sweep's start"));

    // Stated units and bases are taken as well: as milliseconds, 0.1 is no sweep.
    CHECK(contains(inspected(scratch, data, "--set dataset.point_time_unit=ms").output, "in no unit"));
    CHECK(contains(
        inspected(scratch, data, "--set dataset.point_time_base=absolute --set dataset.point_time_unit=s").output,
        "absolute"));
  }

  TEST_CASE("subcommands, options and their values that are mistyped are answered by the nearest") {
    const ScratchFolder scratch("nearest");
    const auto complaint = [&](const std::string& arguments) {
      const ProgramResult result = run_program(scratch.path(), arguments);
      CHECK(result.exit_code == 2);
      return result.errors;
    };
    CHECK(contains(complaint("mpa somewhere"), "found: unknown subcommand 'mpa'; did you mean 'map'?\n"));
    CHECK(contains(complaint("qqqqqq"), "found: unknown subcommand 'qqqqqq'\n"));
    CHECK(contains(complaint("--verson"), "found: unknown option '--verson'; did you mean '--version'?\n"));
    CHECK(contains(complaint("map x --oot y"), "found: unknown option '--oot'; did you mean '--out'?\n"));
    CHECK(contains(complaint("map x --outt=y"), "did you mean '--out'?"));
    CHECK(contains(complaint("export a --format pdc --out b"),
                   "--format: 'pdc' is none of tum|kitti|g2o|ply|pcd|las|grid|colmap; did you mean 'pcd'?\n"));
    CHECK(contains(complaint("eval a b --align sim2"), "'sim2' is none of none|origin|se3|sim3; did you mean 'sim3'?"));
    CHECK(contains(complaint("simulate twon --out x"), "found: twon; did you mean 'town'?\n"));
    CHECK(contains(complaint("simulate nclt-hard --without lazer-angles --out x"), "did you mean 'laser-angles'?"));
    CHECK(contains(complaint("map simulate:nclt-like/smal/1 --out x"), "did you mean 'small'?"));
    CHECK(contains(complaint("map simulate:nclt-lik/small/1 --out x"), "did you mean 'nclt-like'?"));
  }

  TEST_CASE("--version says how the program was built") {
    const ScratchFolder scratch("version");
    const ProgramResult result = run_program(scratch.path(), "--version");
    CHECK(result.exit_code == 0);
    CHECK(result.output.starts_with("chainslam "));
    CHECK(fact(result.output, "compiler") != "(none)");
    CHECK(contains(fact(result.output, "configuration"), "assertions o"));
    CHECK(fact(result.output, "instruction set") != "(none)");
    CHECK(contains(fact(result.output, "libraries"), "Eigen 3."));
  }

  TEST_CASE("settings are printed with numbers as people write them, and described by sentences") {
    const ScratchFolder scratch("settings");
    const std::string text = run_program(scratch.path(), "config --print").output;
    CHECK(contains(text, "\nmin_interval = 30.0\n"));
    CHECK(contains(text, "\nangle = 11.4592\n"));
    std::size_t described = 0, numbers = 0;
    for (const std::string& line : trimmed_lines(text)) {
      if (line.starts_with("# ")) {
        CHECK_MESSAGE(line.ends_with("."), line);
        CHECK_MESSAGE(contains(line, ". Takes "), line);
        ++described;
      } else if (const std::size_t equals = line.find(" = "); equals != std::string::npos) {
        const std::string value = line.substr(equals + 3);
        if (value.find_first_not_of("0123456789.e-") == std::string::npos) {
          CHECK_MESSAGE(value.size() <= 10, line);
          ++numbers;
        }
      }
    }
    CHECK(described > 100);
    CHECK(numbers > 60);
  }
}
