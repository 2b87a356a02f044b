#include "chainslam/io/map_archive.hpp"

#include <doctest/doctest.h>

#include "io/maps.hpp"
#include "support/files.hpp"
#include "support/property.hpp"

namespace chainslam::test {
namespace {

constexpr const char* parameters = "[odometry]\nvoxel_size = 0.5\n";

/// The journal's bytes after a drive of `keyframes`, with a commit for each group of `group`.
std::string journaled(const std::filesystem::path& path, int keyframes, int group) {
  MapJournal<UnsyncedFiles> journal(path, {.parameters = parameters});
  GrowingMap growing(7);
  for (int i = 0; i < keyframes; ++i) {
    if (i == keyframes / 2) growing.begin_session("second");
    growing.add_keyframe();
    if (i % group == group - 1) journal.update(growing.map());
  }
  growing.merge();
  journal.finish(growing.map());
  return read_bytes(path);
}

}  // namespace

TEST_SUITE("io/map_archive") {
  TEST_CASE("what is saved comes back bit for bit, and saving it again gives the same bytes") {
    for_all(20, [](Rng& rng, int size) {
      const TemporaryFolder folder;
      const SlamMap map = random_map(rng.bits(), size);
      save_map(folder / "a.cslam", map, {.parameters = parameters}, UnsyncedFiles{});
      const LoadedMap loaded = load_map(folder / "a.cslam");
      CHECK(same_map(loaded.map, map));
      CHECK(loaded.parameters == parameters);
      CHECK(loaded.report.complete);
      CHECK(loaded.report.problems.empty());
      CHECK(loaded.report.ignored_bytes == 0);
      CHECK(loaded.report.poses_by_odometry == 0);
      save_map(folder / "b.cslam", loaded, false, UnsyncedFiles{});
      CHECK(read_bytes(folder / "a.cslam") == read_bytes(folder / "b.cslam"));
      CHECK(folder.files() == 2);
    });
  }

  TEST_CASE("an empty map is a map") {
    const TemporaryFolder folder;
    save_map(folder / "a.cslam", SlamMap{});
    const LoadedMap loaded = load_map(folder / "a.cslam");
    CHECK(loaded.report.complete);
    CHECK(loaded.map.keyframes.empty());
    CHECK(loaded.parameters.empty());
  }

  TEST_CASE("a map that was journaled is the map that was saved at once, and the same calls give the same bytes") {
    const TemporaryFolder folder;
    for (const int group : {1, 3, 10}) {
      const std::string name = std::to_string(group);
      const std::string bytes = journaled(folder / (name + "a"), 40, group);
      CHECK(bytes == journaled(folder / (name + "b"), 40, group));
      GrowingMap growing(7);
      for (int i = 0; i < 40; ++i) {
        if (i == 20) growing.begin_session("second");
        growing.add_keyframe();
      }
      growing.merge();
      CHECK(same_map(load_map(folder / (name + "a")).map, growing.map()));
    }
    CHECK(folder.files() == 6);
  }

  TEST_CASE("poses do not make the file grow with the square of the map") {
    const auto bytes_of = [](int keyframes) {
      const TemporaryFolder folder;
      journaled(folder / "a", keyframes, 1);
      for (const MapFileShare& share : load_map(folder / "a").report.shares)
        if (share.kind == "poses") return static_cast<double>(share.bytes) / keyframes;
      return 0.0;
    };
    // With growth by an eighth each whole set costs at most 1/(1 - 8/9) times the last one; small chunks are padded.
    CHECK(bytes_of(60) < 128 * 11);
    CHECK(bytes_of(600) < 56 * 11);
  }

  TEST_CASE("keyframes without scans and scans that are left out") {
    const TemporaryFolder folder;
    const SlamMap map = random_map(3, 20);
    save_map(folder / "a", map);
    const LoadedMap loaded = load_map(folder / "a", {.scans = false});
    CHECK(loaded.report.complete);
    CHECK(same_records(loaded.map.keyframes, map.keyframes));
    for (const Keyframe& keyframe : loaded.map.keyframes) CHECK(!keyframe.cloud);
  }

  TEST_CASE("maps that break the rules are refused before anything is written") {
    const TemporaryFolder folder;
    const auto refused = [&](auto change) {
      SlamMap map = random_map(3, 12);
      change(map);
      try {
        save_map(folder / "a", map);
      } catch (const std::invalid_argument& error) {
        CHECK(folder.files() == 0);
        return std::string(error.what());
      }
      return std::string();
    };
    const double nan = std::numeric_limits<double>::quiet_NaN();
    CHECK(says(refused([](SlamMap& map) { map.keyframes[3].id = KeyframeId{4}; }), "keyframe 3, id: 4"));
    CHECK(says(refused([](SlamMap& map) { map.keyframes[3].time = map.keyframes[2].time; }), "keyframe 3, time"));
    CHECK(
        says(refused([](SlamMap& map) { map.keyframes[3].session = SessionId{9}; }), "9, where there are 2 sessions"));
    CHECK(says(refused([](SlamMap& map) { map.sessions[0].keyframes = 5; }), "session 1, first keyframe"));
    CHECK(says(refused([](SlamMap& map) { map.sessions[1].keyframes = 5; }), "the sessions have 11 keyframes"));
    CHECK(says(refused([](SlamMap& map) { map.sessions[1].frame = SessionId{2}; }), "session 1, frame: 2"));
    CHECK(says(refused([](SlamMap& map) { map.odometry[2].to = KeyframeId{12}; }), "odometry 2, to: 12"));
    CHECK(says(refused([](SlamMap& map) { map.closures[0].cause = 7; }), "closure 0, cause: 7"));
    CHECK(says(refused([](SlamMap& map) { map.refusals[0].to = map.refusals[0].from; }), "refusal 0, to"));
    CHECK(says(refused([&](SlamMap& map) { map.keyframes[1].T_map_body = SE3d(SO3d(), {nan, 0, 0}); }), "T_map_body"));
    CHECK(
        says(refused([&](SlamMap& map) { map.odometry[0].sqrt_information(2, 2) = nan; }), "odometry 0, information"));
    CHECK(says(refused([](SlamMap& map) { map.keyframes[1].gnss->covariance_ecef(0, 1) = 9; }), "not symmetric"));
    CHECK(says(refused([](SlamMap& map) {
                 PointCloud<float> cloud = *map.keyframes[0].cloud.load();
                 cloud.intensities.resize(3);
                 map.keyframes[0].cloud = std::make_shared<const PointCloud<float>>(cloud);
               }),
               "columns of different lengths"));
    MapJournal<> journal(folder / "b");
    journal.update(random_map(3, 12));
    CHECK_THROWS_AS(journal.update(random_map(3, 11)), std::invalid_argument);
  }

  TEST_CASE("a file's name is never taken from what has it") {
    const TemporaryFolder folder;
    write_bytes(folder / "a", "old");
    CHECK(says(io_error([&] { return save_map(folder / "a", SlamMap{}), 0; }), "kept as a~1"));
    CHECK(read_bytes(folder / "a") == "old");
    save_map(folder / "a", random_map(1, 3), {.overwrite = true});
    CHECK(read_bytes(folder / "a~1") == "old");
    save_map(folder / "a", random_map(2, 3), {.overwrite = true});
    CHECK(same_map(load_map(folder / "a~2").map, random_map(1, 3)));
    CHECK(folder.files() == 3);
    CHECK(says(io_error([&] { return save_map(folder.path(), SlamMap{}, {.overwrite = true}), 0; }), "a folder"));
    CHECK(says(io_error([&] { return save_map(folder / "none/a", SlamMap{}), 0; }), "create the folder"));
  }

  TEST_CASE("a map is written by one process at a time, which is named") {
    const TemporaryFolder folder;
    MapJournal<> journal(folder / "a");
    const std::string error = io_error([&] { return MapJournal<>(folder / "a").size(); });
    CHECK(says(error, "process " + std::to_string(::getpid()) + " is writing this map"));
    CHECK(says(io_error([&] { return MapJournal<>(folder / "a", {.overwrite = true}).size(); }), "is writing"));
    journal.finish(random_map(1, 3));
    CHECK(load_map(folder / "a").report.complete);
  }

  TEST_CASE("what a run left behind is not written over") {
    const TemporaryFolder folder;
    { MapJournal<>(folder / "a").update(random_map(1, 3)); }
    CHECK(folder.files() == 1);
    CHECK(says(io_error([&] { return save_map(folder / "a", random_map(2, 3)), 0; }), "chainslam recover"));
    save_map(folder / "a", random_map(2, 3), {.overwrite = true});
    CHECK(same_map(load_map(folder / "a").map, random_map(2, 3)));
    CHECK(same_map(load_map(folder / "a.partial~1", {.recover = true}).map, random_map(1, 3)));
    { MapJournal<> nothing(folder / "b"); }
    CHECK(folder.files() == 2);
  }

  TEST_CASE("files that are no maps are told apart") {
    const TemporaryFolder folder;
    write_bytes(folder / "short",
                "\x89"
                "CSLAM");
    write_bytes(folder / "text", std::string(500, 'x'));
    CHECK(says(io_error([&] { return load_map(folder / "none"); }), "no such file"));
    CHECK(says(io_error([&] { return load_map(folder.path()); }), "not a plain file"));
    CHECK(says(io_error([&] { return load_map(folder / "short"); }), "6 bytes, which is no map"));
    CHECK(says(io_error([&] { return load_map(folder / "text"); }), "no map's mark"));
  }

  TEST_CASE("a limit on memory is kept") {
    const TemporaryFolder folder;
    save_map(folder / "a", random_map(1, 20, 500));
    CHECK(says(io_error([&] { return load_map(folder / "a", {.max_memory = 20'000}); }), "raise the limit"));
    CHECK(load_map(folder / "a", {.max_memory = 10'000'000}).report.complete);
    CHECK(load_map(folder / "a", {.scans = false, .max_memory = 40'000}).report.complete);
  }
}

}  // namespace chainslam::test
