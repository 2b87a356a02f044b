#include <string>
#include <vector>

#include "chainslam/core/error.hpp"
#include "chainslam/io/map_archive.hpp"
#include "program/faults.hpp"
#include "program/keyframe_data.hpp"

#include <doctest/doctest.h>

namespace {

using namespace chainslam;
using namespace chainslam::test;

/// A name that would clear a terminal, end a script and pass for a line of its own.
const std::string evil =
    "a\x1b[2J\x9B"
    "1m\n  do: rm <script>alert(1)</script>\" onload=\"x\xE2\x80\xAE&amp;<script><!--";

/// In a shell's single quotes; the name has none.
std::string shelled(const fs::path& path) { return quoted(path); }

/// Whether a text that is printed holds nothing but printable characters and line feeds.
bool harmless(const std::string& text) { return printable(text, true) == text; }

}  // namespace

TEST_SUITE("program/names") {
  TEST_CASE("names of files and sessions cannot coarse_stage a terminal, a page or a table") {
    const ScratchFolder scratch("names");
    const fs::path root = scratch.path() / "root", data = root / evil, out = root / ("out" + evil);
    // A slash parts folders: the name is a folder in a folder.
    fs::create_directories(data.parent_path());
    write_keyframes(data, 6, true, 5, 20);
    const std::string map = quoted(out / "map.cslam"), none = quoted(root / ("none" + evil));
    const std::vector<std::string> commands{
        "map " + shelled(data) + " --out " + quoted(out),
        "map " + shelled(data) + " --out " + quoted(out),  // it is there
        "inspect " + shelled(data),
        "inspect " + quoted(out),
        "inspect " + map + " --closures",
        "check " + map,
        "undo " + map + " --session 0 -o " + quoted(out / ("u" + evil)),
        "undo " + map + " --session '" + evil + "' -o " + quoted(root / "u"),
        "merge " + map + " " + map + " -o " + quoted(root / ("m" + evil)),
        "report " + map + " --out " + quoted(root / ("report" + evil)),
        "check " + none,
        "recover " + map + " --out " + quoted(out / ("r" + evil)),
        "export " + map + " --format tum --out " + quoted(root / "tum"),
        "export " + none + " --format tum --out " + quoted(root / "tum2"),
        "eval " + quoted(out / "trajectory.tum") + " " + none,
        "eval " + quoted(out / "trajectory.tum") + " " + quoted(out / "odometry.tum"),
        "optimize " + none,
        "optimize " + quoted(out / "graph.g2o"),
        "map " + none + " --out " + quoted(root / "b"),
        "map " + shelled(data) + " --load " + none + " --out " + quoted(root / "b"),
        "map " + shelled(data) + " --config " + none + " --out " + quoted(root / "b"),
        "map 'simulate:" + evil + "' --out " + quoted(root / "b"),
        "simulate '" + evil + "' --out " + quoted(root / "b"),
        "config --print --set '" + evil + "=1'",
        "config --print --set 'dataset.lidar_topic=" + evil + "'",
        "config --explain '" + evil + "'",
        "eval a b --align '" + evil + "'",
        "'" + evil + "'"};
    int named = 0;
    for (const std::string& command : commands) {
      CAPTURE(printable(command, true));
      const ProgramResult result = run_program(scratch.path(), command);
      CHECK(result.exit_code != 70);
      CHECK_MESSAGE(harmless(result.output), printable(result.output, true));
      CHECK_MESSAGE(harmless(result.errors), printable(result.errors, true));
      CHECK(!contains(result.errors, "\n  do: rm"));  // a line of the name's own
      CHECK(!contains(result.output, "\n  do: rm"));
      named += contains(result.output + result.errors, "\\x1B");
    }
    CHECK(named >= 10);
    const std::string session = data.filename().string(), page = read_text(out / "report.html");
    REQUIRE(!page.empty());
    CHECK(!contains(page, "\x1b"));
    CHECK(!contains(page, "<script>alert"));
    CHECK(!contains(page, "alert(1)</script>"));
    CHECK(!contains(page, "<script><!--"));
    for (std::size_t at = page.find("\" onload="); at != std::string::npos; at = page.find("\" onload=", at + 1))
      CHECK(page[at - 1] == '\\');                   // in the script's data, not in a tag
    const nlohmann::json summary = summary_of(out);  // which would not parse
    CHECK(contains(summary.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace), "onload"));
    for (const auto& entry : fs::directory_iterator(out))
      if (entry.path().extension() != ".cslam" && entry.path().extension() != ".png" &&
          entry.path().extension() != ".ply") {
        CAPTURE(entry.path().filename().string());
        CHECK(!contains(read_text(entry.path()), "\x1b"));
      }
  }
}
