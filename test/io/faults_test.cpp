#include <doctest/doctest.h>

#include <cstdio>

#include "chainslam/io/atomic_file.hpp"
#include "chainslam/io/g2o.hpp"
#include "chainslam/io/input_journal.hpp"
#include "chainslam/io/map_archive.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "io/maps.hpp"
#include "io/traced_files.hpp"
#include "support/files.hpp"

namespace chainslam::test {
namespace {

namespace fs = std::filesystem;
using Kind = DiskOperation::Kind;

constexpr int errors[] = {ENOSPC, EIO, EDQUOT, EINTR, TracedFiles::short_write};

/// Makes each operation of `action` fail once with each error.
/// @param action  is given the files; throws IoError.
/// @param check   is given the error's words, empty if there was none, and the files.
/// @returns how many operations failed.
template <class Prepare, class Action, class Check>
int fail_everywhere(const Prepare& prepare, const Action& action, const Check& check) {
  int operations = 0, failures = 0;
  {
    const TemporaryFolder folder;
    prepare(folder.path());
    TracedFiles files;
    action(folder.path(), files);
    operations = files.operations();
  }
  for (const int error : errors)
    for (int number = 0; number < operations; ++number) {
      const TemporaryFolder folder;
      prepare(folder.path());
      TracedFiles files(number, error);
      const std::string words = io_error([&] { return action(folder.path(), files), 0; });
      CAPTURE(error);
      CAPTURE(number);
      CAPTURE(static_cast<int>(files.failed_kind()));
      CAPTURE(words);
      if (files.failed()) ++failures;
      if (!words.empty()) {
        CHECK(files.failed());
        CHECK(says(words, "\n  found: "));
        CHECK(says(words, "\n  do: "));
        CHECK(says(words, folder.path().string()));
      }
      if (error == EINTR || error == TracedFiles::short_write) CHECK(words.empty());
      check(folder.path(), words, files);
    }
  return failures;
}

}  // namespace

TEST_SUITE("io/faults") {
  TEST_CASE("every operation of saving a map over another fails once with every error: the old map stays, or the new") {
    const SlamMap old = random_map(1, 5), fresh = random_map(2, 7);
    const TemporaryFolder first;
    save_map(first / "a", old);
    const std::string before = read_bytes(first / "a");
    const int failures = fail_everywhere(
        [&](const fs::path& folder) { write_bytes(folder / "a", before); },
        [&](const fs::path& folder, TracedFiles& files) { save_map(folder / "a", fresh, {.overwrite = true}, files); },
        [&](const fs::path& folder, const std::string& words, const TracedFiles& files) {
          const SlamMap found = load_map(folder / "a").map;  // by its name, whatever failed
          const bool unsure = files.failed() && files.failed_kind() == Kind::sync_directory;
          CHECK(same_map(found, words.empty() || (unsure && same_map(found, fresh)) ? fresh : old));
          if (words.empty()) CHECK(same_map(load_map(folder / "a~1").map, old));
        });
    std::printf("FIGURE saving a map over another: %d operations failed, each with a clear error or done again\n",
                failures);
    CHECK(failures > 50);
  }

  TEST_CASE("every operation of journaling a map fails once with every error: what was committed stays") {
    GrowingMap growing(2);
    std::vector<SlamMap> maps;
    for (int i = 0; i < 5; ++i) {
      growing.add_keyframe();
      maps.push_back(growing.map());
    }
    std::size_t committed = 0;
    const int failures = fail_everywhere(
        [&](const fs::path&) { committed = 0; },
        [&](const fs::path& folder, TracedFiles& files) {
          MapJournal<TracedFiles> journal(folder / "a", {}, files);
          for (const SlamMap& map : maps) {
            journal.update(map);
            ++committed;
          }
          journal.finish(maps.back());
        },
        [&](const fs::path& folder, const std::string& words, const TracedFiles&) {
          if (fs::exists(folder / "a")) {
            CHECK(same_map(load_map(folder / "a").map, maps.back()));
            return;
          }
          CHECK(!words.empty());
          if (committed == 0) return;
          CHECK(says(words, "chainslam recover"));
          const SlamMap found = load_map(folder / "a.partial", {.recover = true}).map;
          CHECK((same_map(found, maps[committed - 1]) || same_map(found, maps[std::min(committed, maps.size() - 1)])));
        });
    CHECK(failures > 80);
  }

  TEST_CASE("every operation of a journal of inputs fails once with every error: what was acknowledged stays") {
    const SlamMap map = random_map(3, 6);
    Index committed = 0;
    const int failures =
        fail_everywhere([&](const fs::path&) { committed = 0; },
                        [&](const fs::path& folder, TracedFiles& files) {
                          InputJournal<TracedFiles> journal(folder / "in", "x = 1\n", {}, files);
                          for (const Keyframe& keyframe : map.keyframes) {
                            if (keyframe.session.value > 0 && keyframe.id.value == map.sessions[1].first_keyframe)
                              journal.append(SessionStart{"second"});
                            journal.append(keyframe);
                            journal.commit();
                            ++committed;
                          }
                        },
                        [&](const fs::path& folder, const std::string& words, const TracedFiles&) {
                          CHECK((words.empty() == (committed == to_index(map.keyframes.size()))));
                          if (committed == 0) return;
                          const JournaledInput recorded = read_input_journal(folder / "in.partial");
                          CHECK(recorded.keyframes >= committed);
                          CHECK(recorded.problems.empty());
                        });
    CHECK(failures > 50);
  }

  TEST_CASE("every operation of writing a result fails once with every error: the old file stays, and nothing else") {
    int failures = 0;
    for (const Existing existing : {Existing::replace, Existing::keep, Existing::refuse})
      failures += fail_everywhere(
          [&](const fs::path& folder) {
            if (existing != Existing::refuse) write_bytes(folder / "a", "old");
          },
          [&](const fs::path& folder, TracedFiles& files) {
            BasicAtomicFile<TracedFiles> file(FileTarget(folder / "a", existing), files);
            file.write(std::string(9000, 'n'));
            file.commit();
          },
          [&](const fs::path& folder, const std::string& words, const TracedFiles& files) {
            const std::string found = read_bytes(folder / "a");
            const bool named = words.empty() || files.failed_kind() == Kind::sync_directory;
            CHECK(found == (named ? std::string(9000, 'n') : existing == Existing::refuse ? "" : "old"));
            for (const auto& entry : fs::directory_iterator(folder)) {
              const std::string name = entry.path().filename().string();
              CHECK((name == "a" || (name == "a~1" && existing == Existing::keep && named) ||
                     files.failed_kind() == Kind::remove));
            }
          });
    CHECK(failures > 50);
  }

  TEST_CASE("a name that another process takes meanwhile is not replaced") {
    const TemporaryFolder folder;
    AtomicFile file(FileTarget(folder / "a", Existing::refuse));
    file.write("mine");
    write_bytes(folder / "a", "theirs");
    CHECK(says(io_error([&] { return file.commit(), 0; }), "something is there already"));
    CHECK(read_bytes(folder / "a") == "theirs");
    CHECK(folder.files() == 1);
    MapJournal<UnsyncedFiles> journal(folder / "b");
    write_bytes(folder / "b", "theirs");
    CHECK(says(io_error([&] { return journal.finish(random_map(1, 3)), 0; }), "something is there already"));
    CHECK(read_bytes(folder / "b") == "theirs");
    CHECK(load_map(folder / "b.partial", {.recover = true}).map.keyframes.size() == 3);
  }

  TEST_CASE("no writer writes a number that is not finite") {
    const TemporaryFolder folder;
    const double nan = std::numeric_limits<double>::quiet_NaN(), infinite = std::numeric_limits<double>::infinity();
    for (const double bad : {nan, infinite, -infinite}) {
      const SE3d pose(SO3d(), {0, bad, 0});
      const Trajectory trajectory{{Timestamp::from_seconds(1)}, {pose}};
      G2oFile vertex, edge, information;
      vertex.spatial.vertices.push_back({0, pose});
      edge.spatial.edges.push_back({.from = 0, .to = 1, .measurement = pose, .information = Matrix6d::Identity()});
      information.spatial.edges.push_back(
          {.from = 0, .to = 1, .measurement = SE3d(), .information = bad * Matrix6d::Identity()});
      CHECK(says(io_error([&] { return write_tum(folder / "a", trajectory), 0; }),
                 "pose 0\n  found: a number that is NaN"));
      CHECK(says(io_error([&] { return write_kitti_poses(folder / "a", trajectory), 0; }), "pose 0"));
      CHECK(says(io_error([&] { return write_g2o(folder / "a", vertex), 0; }), "vertex 0"));
      CHECK(says(io_error([&] { return write_g2o(folder / "a", edge), 0; }), "edge to vertex 1"));
      CHECK(says(io_error([&] { return write_g2o(folder / "a", information), 0; }), "edge to vertex 1"));
      Keyframe keyframe;
      keyframe.T_odom_body = pose;
      InputJournal<UnsyncedFiles> journal(folder / "in");
      CHECK_THROWS_AS(journal.append(keyframe), std::invalid_argument);
    }
    CHECK(folder.files() == 0);
  }
}

}  // namespace chainslam::test
