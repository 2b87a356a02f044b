#include <doctest/doctest.h>

#include <algorithm>
#include <cstdio>
#include <set>

#include "chainslam/io/atomic_file.hpp"
#include "chainslam/io/input_journal.hpp"
#include "chainslam/io/map_archive.hpp"
#include "io/maps.hpp"
#include "io/traced_files.hpp"
#include "support/files.hpp"
#include "support/quick.hpp"

namespace chainslam::test {
namespace {

namespace fs = std::filesystem;
using Unsynced = CutDisk::Unsynced;
using Disk = std::map<std::string, std::string>;

/// After `operations` of them, `count` records had been acknowledged.
struct Acknowledged {
  std::size_t operations = 0, count = 0;
};

std::size_t acknowledged_at(const std::vector<Acknowledged>& all, std::size_t operations) {
  std::size_t count = 0;
  for (const Acknowledged& one : all)
    if (one.operations <= operations) count = one.count;
  return count;
}

/// Cuts a trace after every operation, `rounds` times with each fate of what was not synced.
/// @param check  is given the folder with the disk's files, and the number of operations before the cut.
template <class Check>
int cut_everywhere(const Disk& before, const std::vector<DiskOperation>& trace, int rounds, Check&& check) {
  const TemporaryFolder folder;
  Rng rng(trace.size());
  int states = 0;
  for (std::size_t count = 0; count <= trace.size(); ++count) {
    const CutDisk disk(before, trace, count);
    for (const Unsynced unsynced : {Unsynced::kept, Unsynced::lost, Unsynced::torn, Unsynced::reordered})
      for (int round = 0; round < (unsynced == Unsynced::torn || unsynced == Unsynced::reordered ? rounds : 1);
           ++round) {
        for (const auto& entry : fs::directory_iterator(folder.path())) fs::remove(entry.path());
        for (const auto& [name, bytes] : disk.files(unsynced, rng)) write_bytes(folder / name, bytes);
        CAPTURE(count);
        CAPTURE(static_cast<int>(unsynced));
        CAPTURE(round);
        check(folder.path(), count);
        ++states;
      }
  }
  return states;
}

std::string map_bytes(const SlamMap& map) {
  const TemporaryFolder folder;
  save_map(folder / "a", map, {}, UnsyncedFiles());
  return read_bytes(folder / "a");
}

/// The keyframes of a map as a back end is given them, with frames and fixes before.
std::vector<MapInput> inputs_of(const SlamMap& map) {
  std::vector<MapInput> inputs;
  std::size_t frame = 0;
  for (const Keyframe& keyframe : map.keyframes) {
    if (keyframe.id.value == map.sessions[static_cast<std::size_t>(keyframe.session.value)].first_keyframe)
      inputs.emplace_back(SessionStart{map.sessions[static_cast<std::size_t>(keyframe.session.value)].name});
    std::vector<FrameRecord> frames;
    while (frame < map.frames.size() && map.frames[frame].session == keyframe.session &&
           map.frames[frame].time <= keyframe.time)
      frames.push_back(map.frames[frame++]);
    inputs.emplace_back(std::move(frames));
    if (keyframe.gnss) inputs.emplace_back(*keyframe.gnss);
    inputs.emplace_back(keyframe);
  }
  return inputs;
}

bool same_input(const MapInput& a, const MapInput& b) {
  if (a.index() != b.index()) return false;
  if (const auto* start = std::get_if<SessionStart>(&a)) return start->name == std::get<SessionStart>(b).name;
  if (const auto* frames = std::get_if<std::vector<FrameRecord>>(&a))
    return same_records(*frames, std::get<std::vector<FrameRecord>>(b));
  if (const auto* fix = std::get_if<GnssFix>(&a)) return same_fix(*fix, std::get<GnssFix>(b));
  const Keyframe &x = std::get<Keyframe>(a), &y = std::get<Keyframe>(b);
  return same_record(x, y) && same_cloud(x.cloud, y.cloud) && same_fix(x.gnss, y.gnss);
}

/// Journals inputs, committing after each keyframe. @returns when how many inputs were acknowledged.
std::vector<Acknowledged> journal_inputs(const fs::path& path, const std::vector<MapInput>& inputs,
                                         const TracedFiles& files) {
  std::vector<Acknowledged> acknowledged;
  InputJournal<TracedFiles> journal(path, "x = 1\n", {{"/maps/earlier.cslam", 4711}}, files);
  for (std::size_t i = 0; i < inputs.size(); ++i) {
    journal.append(inputs[i]);
    if (!std::holds_alternative<Keyframe>(inputs[i])) continue;
    journal.commit();
    acknowledged.push_back({files.trace().size(), i + 1});
  }
  return acknowledged;
}

}  // namespace

TEST_SUITE("io/power_cut") {
  TEST_CASE("what a journal of inputs says is what was put in, also as a map") {
    const TemporaryFolder folder;
    const SlamMap map = random_map(3, 14);
    const std::vector<MapInput> inputs = inputs_of(map);
    const TracedFiles files;
    CHECK(journal_inputs(folder / "in", inputs, files).back().count == inputs.size());
    const JournaledInput recorded = read_input_journal(folder / "in.partial");
    CHECK(std::equal(inputs.begin(), inputs.end(), recorded.inputs.begin(), recorded.inputs.end(), same_input));
    CHECK(recorded.parameters == "x = 1\n");
    CHECK(recorded.loaded == std::vector<LoadedReference>{{"/maps/earlier.cslam", 4711}});
    CHECK(recorded.keyframes == 14);
    CHECK(recorded.problems.empty());
    const SlamMap as_map = load_map(folder / "in.partial", {.recover = true}).map;
    CHECK(same_records(as_map.keyframes, map.keyframes));
    CHECK(same_records(as_map.frames, map.frames));
    const TemporaryFolder other;
    InputJournal<UnsyncedFiles> journal(other / "in");
    journal.append(inputs.front());
    journal.commit();
    CHECK(fs::exists(journal.path()));
    journal.remove();
    CHECK(other.files() == 0);
  }

  TEST_CASE("a map's file is no journal of inputs, and is refused where it states a session again") {
    const TemporaryFolder folder;
    GrowingMap growing(4);
    MapJournal<UnsyncedFiles> journal(folder / "a");
    for (int i = 0; i < 3; ++i) growing.add_keyframe();
    growing.begin_session("second");
    growing.add_keyframe();
    journal.update(growing.map());
    growing.merge();
    journal.update(growing.map());
    const std::string words = io_error([&] { return read_input_journal(folder / "a.partial").keyframes; });
    CHECK(says(words, "found: a session that the journal had already\n  do: this is no journal of inputs"));
  }

  TEST_CASE("a power cut at any moment: every acknowledged input is there, and none is another") {
    const std::vector<MapInput> inputs = inputs_of(random_map(3, 10, 60));
    const TemporaryFolder folder;
    const TracedFiles files;
    const std::vector<Acknowledged> acknowledged = journal_inputs(folder / "in", inputs, files);
    int more = 0;
    const int states =
        cut_everywhere({}, files.trace(), full() ? 80 : 12, [&](const fs::path& disk, std::size_t count) {
          const std::size_t safe = acknowledged_at(acknowledged, count);
          JournaledInput recorded;
          const std::string error = io_error([&] { return recorded = read_input_journal(disk / "in.partial"), 0; });
          CHECK((error.empty() || safe == 0));
          CHECK(recorded.inputs.size() >= safe);
          more += recorded.inputs.size() > safe;
          REQUIRE(recorded.inputs.size() <= inputs.size());
          CHECK(std::equal(recorded.inputs.begin(), recorded.inputs.end(), inputs.begin(), same_input));
        });
    std::printf("FIGURE power cuts of a journal of inputs: %d states, %d of them with more than was acknowledged\n",
                states, more);
    CHECK(states >= (full() ? 4000 : 700));
  }

  TEST_CASE("a power cut while a map is saved over another: the old map or the new one, whole, by its name") {
    const SlamMap old = random_map(1, 6), fresh = random_map(2, 9);
    const Disk before{{"a", map_bytes(old)}};
    const TemporaryFolder folder;
    write_bytes(folder / "a", before.at("a"));
    const TracedFiles files;
    save_map(folder / "a", fresh, {.overwrite = true}, files);
    int news = 0;
    const int states =
        cut_everywhere(before, files.trace(), full() ? 150 : 24, [&](const fs::path& disk, std::size_t count) {
          const SlamMap found = load_map(disk / "a").map;
          const bool is_new = same_map(found, fresh);
          CHECK((is_new || same_map(found, old)));
          CHECK((is_new || count < files.trace().size()));  // saved is saved
          if (is_new && fs::exists(disk / "a~1")) CHECK(same_map(load_map(disk / "a~1").map, old));
          news += is_new;
          if (!fs::exists(disk / "a.partial")) return;
          LoadedMap left;
          if (!io_error([&] { return left = load_map(disk / "a.partial", {.recover = true}), 0; }).empty()) return;
          CHECK(same_map(left.map, fresh));
        });
    CHECK(news > 0);
    CHECK(states >= (full() ? 3000 : 500));
  }

  TEST_CASE("a power cut while a map grows: all that was committed is there, and nothing else") {
    GrowingMap growing(11, 6);
    std::vector<SlamMap> maps{{}};
    const TemporaryFolder folder;
    const TracedFiles files;
    std::vector<Acknowledged> acknowledged;
    {
      MapJournal<TracedFiles> journal(folder / "a", {}, files);
      for (int i = 0; i < 9; ++i) {
        if (i == 5) growing.begin_session("second");
        growing.add_keyframe();
        maps.push_back(growing.map());
        if (i % 3 == 1) {  // acknowledged with the next
          journal.append(growing.map());
          continue;
        }
        journal.update(growing.map());
        acknowledged.push_back({files.trace().size(), maps.size() - 1});
      }
      growing.merge();
      journal.finish(growing.map());
      maps.push_back(growing.map());
      acknowledged.push_back({files.trace().size(), maps.size() - 1});
    }
    const int states =
        cut_everywhere({}, files.trace(), full() ? 120 : 16, [&](const fs::path& disk, std::size_t count) {
          const std::size_t safe = acknowledged_at(acknowledged, count);
          const bool finished = fs::exists(disk / "a");
          LoadedMap loaded;
          const std::string error = io_error(
              [&] { return loaded = load_map(disk / (finished ? "a" : "a.partial"), {.recover = !finished}), 0; });
          if (!error.empty()) {
            CHECK(safe == 0);
            return;
          }
          // What was not acknowledged may have lost poses, fixes or frames: then the report says so.
          const bool damaged = std::ranges::any_of(
              loaded.report.problems, [](const std::string& problem) { return says(problem, ": damaged"); });
          bool known = false;
          for (std::size_t i = std::max<std::size_t>(safe, 1); i < maps.size(); ++i)
            known |= same_map(loaded.map, maps[i]) ||
                     (damaged && i > safe && same_records(loaded.map.keyframes, maps[i].keyframes) &&
                      same_records(loaded.map.closures, maps[i].closures));
          CHECK(known);
        });
    CHECK(states >= (full() ? 3000 : 500));
  }

  TEST_CASE("keyframes that are appended without a sync make the same file, and the next sync is of them, too") {
    const auto written = [](bool append) {
      GrowingMap growing(12, 6);
      const TemporaryFolder folder;
      const TracedFiles files;
      MapJournal<TracedFiles> journal(folder / "a", {}, files);
      const auto count_syncs = [&] {
        return std::ranges::count(files.trace(), DiskOperation::Kind::sync, &DiskOperation::kind);
      };
      std::vector<std::ptrdiff_t> syncs;
      for (int i = 0; i < 6; ++i) {
        growing.add_keyframe();
        if (append && i % 2 == 0)
          journal.append(growing.map());
        else
          journal.update(growing.map());
        syncs.push_back(count_syncs());
        CHECK(fs::file_size(journal.partial_path()) == journal.size());
      }
      journal.update(growing.map());  // nothing new
      syncs.push_back(count_syncs());
      journal.finish(growing.map());
      return std::pair(read_bytes(folder / "a"), syncs);
    };
    const auto [updated, all] = written(false);
    const auto [appended, some] = written(true);
    CHECK(updated == appended);
    for (std::size_t i = 1; i < 6; ++i) CHECK(all[i] > all[i - 1]);
    CHECK(all[6] == all[5]);
    for (std::size_t i = 2; i < 6; i += 2) CHECK((some[i] == some[i - 1] && some[i + 1] > some[i]));
  }

  TEST_CASE("a power cut while a result is written: the old file or the new one") {
    const Disk before{{"a", "the old file"}};
    const std::string fresh(20'000, 'n');
    int states = 0;
    for (const Existing existing : {Existing::replace, Existing::keep}) {
      const TemporaryFolder folder;
      write_bytes(folder / "a", before.at("a"));
      const TracedFiles files;
      BasicAtomicFile<TracedFiles> file(FileTarget(folder / "a", existing), files);
      file.write(fresh);
      file.commit();
      states += cut_everywhere(before, files.trace(), full() ? 120 : 20, [&](const fs::path& disk, std::size_t count) {
        const std::string found = read_bytes(disk / "a");
        CHECK((found == fresh || (found == before.at("a") && count < files.trace().size())));
        if (existing == Existing::keep && found == fresh && count == files.trace().size())
          CHECK(read_bytes(disk / "a~1") == before.at("a"));
      });
    }
    CHECK(states >= (full() ? 1500 : 300));
  }
}

}  // namespace chainslam::test
