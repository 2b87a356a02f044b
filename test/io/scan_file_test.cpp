#include "chainslam/io/detail/scan_file.hpp"

#include <doctest/doctest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cerrno>
#include <fstream>
#include <limits>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "chainslam/io/input_journal.hpp"
#include "chainslam/io/map_archive.hpp"
#include "chainslam/slam/slam_map.hpp"
#include "io/maps.hpp"
#include "support/files.hpp"
#include "support/property.hpp"
#include "support/threads_cases.hpp"

namespace chainslam::test {
namespace {

constexpr std::size_t unlimited = std::numeric_limits<std::size_t>::max();

std::shared_ptr<ScanCache> cache_of(std::size_t bytes) { return std::make_shared<ScanCache>(bytes); }

bool is_in_memory(const Keyframe& keyframe) { return keyframe.cloud.place().cloud != nullptr; }

/// While it lives, the process may open one file more.
class OneMoreFile {
 public:
  OneMoreFile() {
    const int next = ::dup(0);
    ::close(next);
    REQUIRE(::getrlimit(RLIMIT_NOFILE, &before_) == 0);
    const rlimit limit{static_cast<rlim_t>(next) + 1, before_.rlim_max};
    REQUIRE(::setrlimit(RLIMIT_NOFILE, &limit) == 0);
  }
  OneMoreFile(const OneMoreFile&) = delete;
  OneMoreFile& operator=(const OneMoreFile&) = delete;
  ~OneMoreFile() { CHECK(::setrlimit(RLIMIT_NOFILE, &before_) == 0); }

 private:
  rlimit before_{};
};

/// Numbers of a file's chunks of scans.
std::vector<std::size_t> scan_chunks(const chainslam::detail::MapFileReader& file) {
  std::vector<std::size_t> numbers;
  for (std::size_t i = 0; i < file.chunks().size(); ++i)
    if (file.chunks()[i].header.is(chainslam::detail::ChunkType::scan)) numbers.push_back(i);
  return numbers;
}

/// A file of two keyframes whose scans follow in the order given.
void write_two_scans(const std::filesystem::path& path, std::array<Index, 2> order) {
  using Type = chainslam::detail::ChunkType;
  const SlamMap map = random_map(1, 2);
  chainslam::detail::ChunkWriter<UnsyncedFiles> writer(path, false, {});
  writer.start(1, {});
  for (const Session& session : map.sessions) {
    std::vector<std::byte> payload;
    chainslam::detail::append_session(payload, session);
    writer.append(Type::session, 1, std::move(payload));
  }
  writer.append_records(Type::keyframes, chainslam::detail::keyframe_bytes, 0, 2, [&](auto& out, Index i) {
    chainslam::detail::append_keyframe(out, map.keyframes[static_cast<std::size_t>(i)]);
  });
  for (const Index i : order) writer.append_scan(KeyframeId{i}, map.keyframes[static_cast<std::size_t>(i)].cloud);
  writer.append_commit({2, 2, 2, 0, 0, 0});
  writer.append_index_and_end();
  writer.file().finish();
}

}  // namespace

TEST_SUITE("map/keyframe_scan") {
  TEST_CASE("a scan in memory is given as it is; copies are the same scan") {
    const auto cloud = std::make_shared<PointCloud<float>>();
    cloud->positions = {{1, 2, 3}, {4, 5, 6}};
    const KeyframeScan scan = cloud, copy = scan, other = cloud, none, null = std::shared_ptr<PointCloud<float>>();
    CHECK(scan);
    CHECK(scan.size() == 2);
    CHECK(scan.load() == cloud);
    CHECK(scan == copy);
    CHECK_FALSE(scan == other);
    for (const KeyframeScan& empty : {none, null}) {
      CHECK_FALSE(empty);
      CHECK(empty.size() == 0);
      CHECK(empty.load() == nullptr);
    }
    KeyframeScan dropped = scan;
    dropped.reset();
    CHECK_FALSE(dropped);
    CHECK(scan.load() == cloud);
  }

  TEST_CASE("the cache keeps what was used last within its bytes, but always one scan") {
    const auto cloud = [](std::size_t points) {
      PointCloud<float> positions;
      positions.positions.resize(points);
      return std::make_shared<const PointCloud<float>>(positions);
    };
    const std::size_t each = ScanCache::bytes_of(*cloud(100));
    CHECK(each >= 1200);
    ScanCache cache(3 * each);
    const std::uint64_t a = cache.add_source(), b = cache.add_source();
    for (std::size_t i = 0; i < 3; ++i) cache.keep(a, i, cloud(100));
    CHECK(cache.bytes() == 3 * each);
    CHECK(cache.find(a, 0));  // now 1 is the one used least recently
    cache.keep(b, 0, cloud(100));
    CHECK(cache.size() == 3);
    CHECK_FALSE(cache.find(a, 1));
    CHECK(cache.find(a, 0));
    CHECK(cache.find(a, 2));
    const auto first = cache.find(b, 0);
    CHECK(cache.keep(b, 0, cloud(100)) == first);
    cache.drop_source(a);
    CHECK(cache.size() == 1);
    CHECK(cache.bytes() == each);
    cache.keep(b, 1, cloud(1000));  // more than all may be
    CHECK(cache.size() == 1);
    CHECK(cache.find(b, 1)->size() == 1000);
  }
}

TEST_SUITE("io/scan_file") {
  TEST_CASE("a map whose scans stay in the file has the same ones, bit for bit, with any cache; opening unpacks none") {
    for_all(6, [](Rng& rng, int size) {
      const TemporaryFolder folder;
      const SlamMap map = random_map(rng.bits(), size + 20);
      save_map(folder / "a.cslam", map, {.parameters = "p"}, UnsyncedFiles{});
      for (const std::size_t bytes : {std::size_t{0}, std::size_t{2000}, unlimited}) {
        const auto cache = cache_of(bytes);
        const LoadedMap loaded = load_map(folder / "a.cslam", {.scan_cache = cache});
        CHECK(loaded.report.complete);
        CHECK(cache->size() == 0);
        for (std::size_t i = 0; i < map.keyframes.size(); ++i) {
          CHECK_FALSE(is_in_memory(loaded.map.keyframes[i]));
          CHECK(loaded.map.keyframes[i].cloud.size() == map.keyframes[i].cloud.size());
        }
        save_map(folder / "b.cslam", loaded, true, UnsyncedFiles{});
        CHECK(cache->size() == 0);  // copied as they were stored
        CHECK(read_bytes(folder / "a.cslam") == read_bytes(folder / "b.cslam"));
        CHECK(same_map(loaded.map, map));
        CHECK(cache->size() > 0);
        CHECK((cache->bytes() <= bytes || cache->size() == 1));
      }
    });
  }

  TEST_CASE("files of all earlier formats can be left on the disk, too") {
    for (const char* name : {"map_1_0", "map_1_1", "map_1_2", "map_1_3"}) {
      const std::string path = std::string(CHAINSLAM_SOURCE_DIR "/test/io/golden/") + name + ".cslam";
      CHECK(same_map(load_map(path, {.scan_cache = cache_of(0)}).map, load_map(path).map));
    }
  }

  TEST_CASE("maps on top of loaded ones are the same bytes, whether their scans had been read or not") {
    const TemporaryFolder folder;
    save_map(folder / "first", random_map(1, 15));
    save_map(folder / "second", random_map(2, 15));
    const auto joined = [&](const std::string& name, const std::shared_ptr<ScanCache>& cache) {
      SlamMap map = load_map(folder / "first", {.scan_cache = cache}).map;
      append_map(map, load_map(folder / "second", {.scan_cache = cache}).map);  // whose keyframes get other numbers
      save_map(folder / name, map, {.scan_cache = cache});
      return read_bytes(folder / name);
    };
    const std::string expected = joined("a", nullptr);
    CHECK(joined("b", cache_of(0)) == expected);
    CHECK(joined("c", cache_of(unlimited)) == expected);
  }

  TEST_CASE("scans leave memory once they are committed, and the journal has the same bytes") {
    const TemporaryFolder folder;
    std::string expected;
    for (const auto& cache : {std::shared_ptr<ScanCache>(), cache_of(0), cache_of(3000), cache_of(unlimited)}) {
      GrowingMap growing(7);
      MapJournal<UnsyncedFiles> journal(folder / "a", {.overwrite = true, .scan_cache = cache});
      SlamMap copy;  // as the back end hands it out
      for (int i = 0; i < 24; ++i) {
        if (i == 12) growing.begin_session("second");
        growing.add_keyframe();
        if (i == 20) copy = growing.map();
        if (i % 3 == 2) journal.update(growing.map());
        for (const Keyframe& keyframe : growing.map().keyframes)
          if (keyframe.cloud) CHECK(is_in_memory(keyframe) == (!cache || keyframe.id.value > i - (i + 1) % 3));
      }
      if (cache) CHECK((cache->size() == 1 || cache->bytes() <= 3000 || cache->size() == 21));
      std::weak_ptr<const PointCloud<float>> points = growing.map().keyframes[0].cloud.load();
      CHECK(points.expired() == false);  // the cache has it
      static_cast<void>(growing.map().keyframes[1].cloud.load());
      if (cache) CHECK(points.expired() == (cache->size() == 1));
      for (const Keyframe& keyframe : copy.keyframes) CHECK(is_in_memory(keyframe) == (!cache && keyframe.cloud));
      growing.add_keyframe();
      growing.add_keyframe();
      journal.finish(growing.map());
      std::filesystem::rename(folder / "a", folder / "moved");
      GrowingMap again(7);
      for (int i = 0; i < 26; ++i) {
        if (i == 12) again.begin_session("second");
        again.add_keyframe();
      }
      CHECK(same_map(growing.map(), again.map()));
      CHECK(is_in_memory(growing.map().keyframes.back()) == !cache);
      const std::string bytes = read_bytes(folder / "moved");
      if (expected.empty()) expected = bytes;
      CHECK(bytes == expected);
    }
  }

  TEST_CASE("a scan that cannot be read any more is named, and the others are there") {
    const TemporaryFolder folder;
    const SlamMap map = random_map(3, 6);
    save_map(folder / "a", map);
    const LoadedMap loaded = load_map(folder / "a", {.scan_cache = cache_of(0)});
    const chainslam::detail::MapFileReader file(folder / "a");
    const auto last = file.chunks()[scan_chunks(file).back()];
    REQUIRE(::truncate((folder / "a").c_str(), static_cast<off_t>(last.offset + 80)) == 0);
    const std::string error = io_error([&] { return loaded.map.keyframes[5].cloud.load(); });
    CHECK(says(error, "a, scan of keyframe 5 at byte " + std::to_string(last.offset) +
                          "\n  found: the end of the file, which was longer before\n  do: check the disk"));
    CHECK(same_cloud(loaded.map.keyframes[4].cloud, map.keyframes[4].cloud));
    CHECK(says(io_error([&] { return save_map(folder / "b", loaded), 0; }), "the end of the file"));
    CHECK_FALSE(std::filesystem::exists(folder / "b"));
  }

  TEST_CASE("a scan that was damaged since it was opened is never taken for whole") {
    const TemporaryFolder folder;
    const SlamMap map = random_map(3, 6);
    save_map(folder / "a", map);
    const LoadedMap loaded = load_map(folder / "a", {.scan_cache = cache_of(0)});
    const chainslam::detail::MapFileReader file(folder / "a");
    std::string bytes = read_bytes(folder / "a");
    bytes[file.chunks()[scan_chunks(file).front()].offset + 100] ^= 1;
    std::ofstream(folder / "a", std::ios::binary | std::ios::in) << bytes;
    CHECK(says(io_error([&] { return loaded.map.keyframes[0].cloud.load(); }), "do not match their checksum"));
    CHECK(says(io_error([&] { return save_map(folder / "b", loaded), 0; }), "do not match their checksum"));
  }

  TEST_CASE("damage is found when a file is opened, whether its scans are read then or not") {
    const TemporaryFolder folder;
    save_map(folder / "a", random_map(3, 12));
    const chainslam::detail::MapFileReader file(folder / "a");
    const std::string whole = read_bytes(folder / "a");
    for (const std::size_t number : scan_chunks(file)) {
      std::string bytes = whole;
      bytes[file.chunks()[number].offset + 90] ^= 1;
      write_bytes(folder / "b", bytes);
      CHECK(says(io_error([&] { return load_map(folder / "b", {.scan_cache = cache_of(0)}); }), "(scan) at byte"));
      const LoadedMap read = load_map(folder / "b", {.recover = true});
      const LoadedMap left = load_map(folder / "b", {.recover = true, .scan_cache = cache_of(0)});
      CHECK(left.report.scans_lost == read.report.scans_lost);
      CHECK(left.report.scans_lost.size() == 1);
      CHECK(left.report.problems == read.report.problems);
      CHECK(same_map(left.map, read.map));
    }
  }

  TEST_CASE("a file that has its scans in another order says so when one is read, not another keyframe's points") {
    const TemporaryFolder folder;
    write_two_scans(folder / "a", {0, 1});
    write_two_scans(folder / "b", {1, 0});
    const LoadedMap loaded = load_map(folder / "a", {.scan_cache = cache_of(0)});
    CHECK(same_map(loaded.map, load_map(folder / "b").map));
    const LoadedMap swapped = load_map(folder / "b", {.scan_cache = cache_of(0)});
    for (const Keyframe& keyframe : swapped.map.keyframes)
      CHECK(says(io_error([&] { return keyframe.cloud.load(); }), "found: the scan of keyframe"));
  }

  TEST_CASE("nothing leaves memory that the disk has not taken") {
    struct FailingSync : UnsyncedFiles {
      int sync_data(int) { return EIO; }
    };
    const TemporaryFolder folder;
    const SlamMap map = random_map(3, 12);
    MapJournal<FailingSync> journal(folder / "a", {.scan_cache = cache_of(0)});
    CHECK(says(io_error([&] { return journal.update(map), 0; }), "making the disk keep the file"));
    for (const Keyframe& keyframe : map.keyframes)
      if (keyframe.cloud) CHECK(is_in_memory(keyframe));
    CHECK(same_map(map, random_map(3, 12)));

    MapJournal<UnsyncedFiles> appended(folder / "b", {.scan_cache = cache_of(0)});
    for (const bool synced : {false, true}) {
      synced ? appended.update(map) : appended.append(map);
      for (const Keyframe& keyframe : map.keyframes)
        if (keyframe.cloud) CHECK(is_in_memory(keyframe) != synced);
    }
    CHECK(same_map(map, random_map(3, 12)));
  }

  TEST_CASE("a file that cannot be opened once more says what helps") {
    const TemporaryFolder folder;
    const SlamMap map = random_map(3, 6);
    save_map(folder / "a", map);
    const OneMoreFile limit;
    CHECK(says(io_error([&] { return load_map(folder / "a", {.scan_cache = cache_of(0)}); }),
               "Too many open files\n  do: allow more open files (ulimit -n)"));
    MapJournal<UnsyncedFiles> journal(folder / "b", {.scan_cache = cache_of(0)});
    CHECK(
        says(io_error([&] { return journal.update(map), 0; }), "b.partial, opening it to be read\n  found: Too many"));
    for (const Keyframe& keyframe : map.keyframes)
      if (keyframe.cloud) CHECK(is_in_memory(keyframe));
  }

  TEST_CASE("inputs whose scans stay in their journal are the same, and a map of them copies the scans") {
    const TemporaryFolder folder;
    const SlamMap map = random_map(3, 12);
    InputJournal<UnsyncedFiles> journal(folder / "in");
    for (const Session& session : map.sessions) {
      journal.append(SessionStart{session.name});
      for (Index i = session.first_keyframe; i < session.end_keyframe(); ++i)
        journal.append(map.keyframes[static_cast<std::size_t>(i)]);
    }
    journal.commit();
    const auto cache = cache_of(unlimited);
    const JournaledInput recorded = read_input_journal(folder / "in.partial", cache);
    SlamMap again = map;
    Index keyframes = 0;
    for (const MapInput& input : recorded.inputs)
      if (const auto* keyframe = std::get_if<Keyframe>(&input))
        again.keyframes[static_cast<std::size_t>(keyframes++)].cloud = keyframe->cloud;
    CHECK(keyframes == 12);
    save_map(folder / "a", again);
    CHECK(cache->size() == 0);
    save_map(folder / "b", map);
    CHECK(read_bytes(folder / "a") == read_bytes(folder / "b"));
    CHECK(same_map(again, map));
  }

  THREADS_TEST_CASE("io/scan_file", "threads read scans through a small cache while more are committed") {
    const TemporaryFolder folder;
    const auto cache = cache_of(4000);
    GrowingMap growing(7, 200), reference(7, 200);
    MapJournal<UnsyncedFiles> journal(folder / "a", {.scan_cache = cache});
    constexpr int count = 40;
    for (int i = 0; i < count; ++i) {
      growing.add_keyframe();
      reference.add_keyframe();
    }
    const SlamMap all = growing.map();  // read while the journal takes the scans out of memory
    std::atomic<int> wrong = 0, read = 0;
    std::atomic<bool> done = false;
    std::vector<std::jthread> readers;
    for (std::uint64_t seed = 0; seed < 3; ++seed)
      readers.emplace_back([&, seed] {
        Rng rng(seed);
        do {
          const auto i = static_cast<std::size_t>(rng.uniform_index(count));
          wrong += !same_cloud(all.keyframes[i].cloud, reference.map().keyframes[i].cloud);
          ++read;
        } while (!done || read < 600);
      });
    SlamMap part = all;
    part.closures.clear();
    part.refusals.clear();
    part.odometry.clear();
    part.frames = {};
    for (int i = 1; i <= count; ++i) {
      part.keyframes.assign(all.keyframes.begin(), all.keyframes.begin() + i);
      part.sessions[0].keyframes = i;
      journal.update(part);
    }
    done = true;
    readers.clear();
    CHECK(wrong == 0);
    CHECK(read >= 600);
    for (const Keyframe& keyframe : all.keyframes) CHECK_FALSE(is_in_memory(keyframe));
  }
}

}  // namespace chainslam::test
