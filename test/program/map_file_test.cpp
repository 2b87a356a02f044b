#include <doctest/doctest.h>

#include <algorithm>

#include "chainslam/io/g2o.hpp"
#include "chainslam/io/map_archive.hpp"
#include "chainslam/io/pcd.hpp"
#include "chainslam/io/ply.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "io/maps.hpp"
#include "program/run_program.hpp"

namespace {

using namespace chainslam;
using namespace chainslam::test;

ProgramResult run(const ScratchFolder& scratch, const std::string& verb, const fs::path& map,
                  const std::string& options = "") {
  return run_program(scratch.path(), verb + " " + quoted(map) + " " + options);
}

}  // namespace

TEST_SUITE("program/map_file") {
  TEST_CASE("inspect says what is in a map file, and lists its closures") {
    const ScratchFolder scratch("map_inspect");
    const fs::path map = scratch.path() / "a.cslam";
    const SlamMap written = random_map(1, 20);
    save_map(map, written, {.parameters = "x = 1\n"});
    const ProgramResult result = run(scratch, "inspect", map, "--closures");
    CAPTURE(result.errors);
    CHECK(result.exit_code == 0);
    CHECK(contains(result.output, "map file"));
    CHECK(contains(result.output, "session 1"));
    CHECK(contains(result.output, "and a\\x0Anew line"));  // a name cannot write to the terminal what it likes
    CHECK(contains(result.output, "closures.chained"));
    CHECK(contains(result.output, "refusals."));
    CHECK(contains(result.output, "\n      0  direct   0 0              0        4      75%"));
    CHECK(contains(result.output, "near by the estimate"));
    CHECK(contains(result.output, "closures connect it with closure 1  accepted\n"));
    CHECK(contains(result.output, "refused: contradicts the chain that led to it\n"));
    CHECK(contains(result.output, "bytes a point"));
    const auto measured = std::ranges::count_if(
        written.frames, [](const FrameRecord& frame) { return frame.delta_velocity.has_value(); });
    CHECK(measured > 0);
    CHECK(measured < std::ssize(written.frames));
    const std::string fact = "frames with acceleration ";
    REQUIRE(contains(result.output, fact));
    CHECK(std::stol(result.output.substr(result.output.find(fact) + fact.size())) == measured);
    CHECK(contains(result.output, "sessions 0 and 1"));
    CHECK(contains(result.output, "joined by 0 places, 0 direct, 1 chained closures"));
  }

  TEST_CASE("check is content with a whole map and exits with 3 on a damaged one, saying what is left") {
    const ScratchFolder scratch("map_check");
    const fs::path map = scratch.path() / "a.cslam", damaged = scratch.path() / "b.cslam";
    save_map(map, random_map(1, 20));
    const ProgramResult whole = run(scratch, "check", map);
    CHECK(whole.exit_code == 0);
    CHECK(contains(whole.output, "2 sessions, 20 keyframes, 17 scans"));
    std::string bytes = read_text(map);
    bytes[bytes.rfind("CHNK\x04") + 70] ^= 4;  // in the last scan
    write_text(damaged, bytes);
    const ProgramResult result = run(scratch, "check", damaged);
    CHECK(result.exit_code == 3);
    CHECK(contains(result.errors, "(scan) at byte"));
    CHECK(contains(result.errors, "scans lost: keyframes 19"));
    CHECK(contains(result.errors, "do: `chainslam recover`"));
    write_text(damaged, "nothing of the kind, and long enough to be looked at as a map's header would be, all of it");
    CHECK(run(scratch, "check", damaged).exit_code == 3);
    CHECK(run(scratch, "check", scratch.path() / "none").exit_code == 3);
  }

  TEST_CASE("recover saves what is whole in a new file, and never works in place") {
    const ScratchFolder scratch("map_recover");
    const fs::path map = scratch.path() / "a.cslam", cut = scratch.path() / "cut.cslam",
                   out = scratch.path() / "c.cslam";
    GrowingMap growing(3);
    {
      MapJournal<> journal(map);
      for (int i = 0; i < 10; ++i) {
        growing.add_keyframe();
        journal.update(growing.map());
      }
    }
    const fs::path partial = scratch.path() / "a.cslam.partial";
    const std::string bytes = read_text(partial);
    write_text(cut, bytes.substr(0, bytes.size() - 300));
    CHECK(run(scratch, "recover", cut, "-o " + quoted(cut) + " --overwrite").exit_code == 4);
    CHECK(read_text(cut) == bytes.substr(0, bytes.size() - 300));
    const ProgramResult result = run(scratch, "recover", cut, "-o " + quoted(out));
    CAPTURE(result.errors);
    CHECK(result.exit_code == 0);
    CHECK(contains(result.output, "9 of 10 keyframes are there"));
    CHECK(contains(result.output, "ignored"));
    CHECK(run(scratch, "check", out).exit_code == 0);
    CHECK(load_map(out).map.keyframes.size() == 9);
    CHECK(run(scratch, "recover", partial, "-o " + quoted(out)).exit_code == 4);
    CHECK(run(scratch, "recover", partial, "-o " + quoted(out) + " --overwrite").exit_code == 0);
    CHECK(same_records(load_map(out).map.keyframes, growing.map().keyframes));
    CHECK(same_records(load_map(out).map.closures, growing.map().closures));
    CHECK(load_map(out.string() + "~1").map.keyframes.size() == 9);
  }

  TEST_CASE("export writes what other programs read") {
    const ScratchFolder scratch("map_export");
    const fs::path file = scratch.path() / "a.cslam";
    const SlamMap map = random_map(1, 20, 100);
    save_map(file, map);
    const auto exported = [&](const std::string& format, const std::string& name, const std::string& more = "") {
      const ProgramResult result =
          run(scratch, "export", file, "--format " + format + " --out " + quoted(scratch.path() / name) + " " + more);
      CAPTURE(result.errors);
      CHECK(result.exit_code == 0);
      return scratch.path() / name;
    };
    const fs::path tum = exported("tum", "tum");
    CHECK(read_tum(tum / "session_0.tum").size() == 10);
    CHECK(read_tum(tum / "session_1.tum").poses.front() == map.keyframes[10].T_map_body);
    CHECK(read_tum(tum / "joint.tum").size() == 20);
    CHECK(read_kitti_poses(exported("kitti", "kitti") / "joint.kitti.txt").size() == 20);
    const G2oFile graph = read_g2o(exported("g2o", "graph.g2o"));
    CHECK(graph.spatial.vertices.size() == 20);
    CHECK(graph.spatial.edges.size() == map.odometry.size() + map.closures.size());
    CHECK(graph.fixed.size() == 1);
    std::size_t points = 0;
    for (const Keyframe& keyframe : map.keyframes) points += keyframe.cloud.size();
    CHECK(read_ply(exported("ply", "map.ply", "--voxel 0")).size() == points);
    const std::size_t thinned = read_pcd(exported("pcd", "map.pcd", "--voxel 10")).size();
    CHECK(thinned > 0);
    CHECK(thinned < points);
    const std::string again = "--format g2o --out " + quoted(scratch.path() / "graph.g2o");
    CHECK(run(scratch, "export", file, again).exit_code == 4);
    CHECK(run(scratch, "export", file, again + " --overwrite").exit_code == 0);
    CHECK(fs::exists(scratch.path() / "graph.g2o~1"));
    CHECK(run(scratch, "export", file, "--format e57 --out x").exit_code == 2);
  }

  TEST_CASE("sessions that were not merged are exported in files of their own") {
    const ScratchFolder scratch("map_frames");
    const fs::path file = scratch.path() / "a.cslam";
    SlamMap map = random_map(1, 20, 100);
    map.sessions[1].frame = SessionId{1};
    save_map(file, map);
    const auto to = [&](const std::string& format, const std::string& name) {
      return "--format " + format + " --out " + quoted(scratch.path() / name);
    };
    CHECK(run(scratch, "export", file, to("tum", "tum")).exit_code == 0);
    CHECK(read_tum(scratch.path() / "tum/joint_frame_1.tum").size() == 10);
    CHECK(run(scratch, "export", file, to("ply", "map.ply")).exit_code == 0);
    CHECK(fs::exists(scratch.path() / "map_frame_0.ply"));
    CHECK(fs::exists(scratch.path() / "map_frame_1.ply"));
    CHECK(run(scratch, "export", file, to("g2o", "graph.g2o")).exit_code == 0);
    CHECK(read_g2o(scratch.path() / "graph.g2o").fixed.size() == 2);
  }
}
