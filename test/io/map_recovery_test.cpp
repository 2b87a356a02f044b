#include <doctest/doctest.h>
#include <fcntl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>

#include "chainslam/io/map_archive.hpp"
#include "io/maps.hpp"
#include "support/files.hpp"
#include "support/property.hpp"

namespace chainslam::test {
namespace {

namespace fs = std::filesystem;

constexpr int drive_keyframes = 8;

/// The map as it was when `size` bytes of its file had been committed.
struct Committed {
  std::uint64_t size;
  SlamMap map;
};

/// A small drive, journaled with two keyframes a commit; so short that each commit has all poses.
std::vector<Committed> journal_drive(const fs::path& path) {
  std::vector<Committed> states;
  GrowingMap growing(11, 6);
  MapJournal<UnsyncedFiles> journal(path, {.parameters = "p"});
  for (int i = 0; i < drive_keyframes; ++i) {
    if (i == 5) growing.begin_session("second");
    growing.add_keyframe();
    if (i % 2 == 0) continue;
    journal.update(growing.map());
    states.push_back({journal.size(), growing.map()});
  }
  growing.merge();
  journal.finish(growing.map());
  const chainslam::detail::MapFileReader file(path);
  const auto commit = std::find_if(file.chunks().rbegin(), file.chunks().rend(), [](const auto& chunk) {
    return chunk.header.is(chainslam::detail::ChunkType::commit);
  });
  states.push_back({commit->end(), growing.map()});
  return states;
}

/// A file whose bytes can be changed in place.
class Patch {
 public:
  Patch(const fs::path& path, std::uint64_t offset, char value)
      : file_(::open(path.c_str(), O_RDWR)), offset_(static_cast<off_t>(offset)) {
    REQUIRE(::pread(file_, &before_, 1, offset_) == 1);
    REQUIRE(::pwrite(file_, &value, 1, offset_) == 1);
  }
  Patch(const Patch&) = delete;
  Patch& operator=(const Patch&) = delete;
  ~Patch() {
    CHECK(::pwrite(file_, &before_, 1, offset_) == 1);
    ::close(file_);
  }

 private:
  int file_;
  off_t offset_;
  char before_ = 0;
};

/// Whether `part` says nothing that `whole` does not: records from the start on, scans as they were or stated lost.
bool is_part(const LoadedMap& part, const SlamMap& whole) {
  const auto begins = [](const auto& some, const auto& all) {
    return some.size() <= all.size() && std::equal(some.begin(), some.end(), all.begin(),
                                                   [](const auto& a, const auto& b) { return same_record(a, b); });
  };
  std::vector<LoopClosure> closures = whole.closures;
  for (std::size_t i = 0; i < std::min(closures.size(), part.map.closures.size()); ++i)  // what was decided later
    if (part.map.closures[i].verdict == ClosureVerdict::accepted) closures[i].verdict = ClosureVerdict::accepted;
  if (!begins(part.map.keyframes, whole.keyframes) || !begins(part.map.odometry, whole.odometry) ||
      !begins(part.map.closures, closures) || part.map.sessions.size() > whole.sessions.size())
    return false;
  for (const LoopClosure& refusal : part.map.refusals)
    if (std::none_of(whole.refusals.begin(), whole.refusals.end(),
                     [&](const LoopClosure& other) { return same_record(refusal, other); }))
      return false;
  const auto& lost = part.report.scans_lost;
  for (std::size_t i = 0; i < part.map.keyframes.size(); ++i) {
    const Keyframe &keyframe = part.map.keyframes[i], &original = whole.keyframes[i];
    const bool stated_lost = std::find(lost.begin(), lost.end(), keyframe.id) != lost.end();
    if (stated_lost ? static_cast<bool>(keyframe.cloud) : !same_cloud(keyframe.cloud, original.cloud)) return false;
    if (keyframe.gnss && !same_fix(keyframe.gnss, original.gnss)) return false;
    if (keyframe.gnss && keyframe.gnss_arrival != original.gnss_arrival) return false;
  }
  return true;
}

/// The machine's own files, with one operation that fails at its n-th call, and writes that take 1000 bytes at most.
class FaultyFiles {
 public:
  enum class Operation { create, write, sync, sync_data, rename, sync_directory, lock };

  FaultyFiles(Operation operation, int countdown, int error)
      : fault_(std::make_shared<Fault>(Fault{operation, countdown, error})) {}

  int create(const fs::path& path) { return fails(Operation::create) ? -fault_->error : real_.create(path); }
  std::ptrdiff_t write(int file, const std::byte* data, std::size_t size) {
    return fails(Operation::write) ? -fault_->error : real_.write(file, data, std::min<std::size_t>(size, 1000));
  }
  int sync(int) { return fails(Operation::sync) ? fault_->error : 0; }  // nothing outlives the test
  int sync_data(int) { return fails(Operation::sync_data) ? fault_->error : 0; }
  int lock(int file) { return fails(Operation::lock) ? fault_->error : real_.lock(file); }
  int close(int file) { return real_.close(file); }
  int rename(const fs::path& from, const fs::path& to) {
    return fails(Operation::rename) ? fault_->error : real_.rename(from, to);
  }
  int rename_new(const fs::path& from, const fs::path& to) {
    return fails(Operation::rename) ? fault_->error : real_.rename_new(from, to);
  }
  int link(const fs::path& from, const fs::path& to) { return real_.link(from, to); }
  int sync_directory(const fs::path&) { return fails(Operation::sync_directory) ? fault_->error : 0; }
  int remove(const fs::path& path) { return real_.remove(path); }

 private:
  struct Fault {
    Operation operation;
    int countdown;
    int error;
  };
  bool fails(Operation operation) { return fault_->operation == operation && fault_->countdown-- == 0; }

  std::shared_ptr<Fault> fault_;
  RealFileSystem real_;
};
static_assert(JournalFileSystem<FaultyFiles>);

}  // namespace

TEST_SUITE("io/map_recovery") {
  TEST_CASE("a file that was cut anywhere gives the last commit before the cut") {
    const TemporaryFolder folder;
    const std::vector<Committed> states = journal_drive(folder / "a");
    const std::uint64_t whole = fs::file_size(folder / "a");
    std::size_t recovered = 0;
    for (std::uint64_t size = whole; size-- > 0;) {
      fs::resize_file(folder / "a", size);
      const Committed* state = nullptr;
      for (const Committed& candidate : states)
        if (candidate.size <= size) state = &candidate;
      LoadedMap loaded;
      const std::string error = io_error([&] { return loaded = load_map(folder / "a", {.recover = true}), 0; });
      CAPTURE(size);
      CHECK(error.empty() == (state != nullptr));
      if (state == nullptr) continue;
      CHECK(!loaded.report.complete);
      CHECK(same_map(loaded.map, state->map));
      CHECK(loaded.report.ignored_bytes == size - state->size);
      CHECK(!loaded.report.problems.empty());
      ++recovered;
      if (size % 64 == 0) CHECK(!io_error([&] { return load_map(folder / "a"); }).empty());
    }
    CHECK(recovered > whole / 2);
  }

  TEST_CASE("10 000 flipped bits: strict loading refuses each, recovery never tells anything wrong") {
    const TemporaryFolder folder;
    const SlamMap map = journal_drive(folder / "a").back().map;
    const std::string bytes = read_bytes(folder / "a");
    int flipped = 0, refused = 0, recovered = 0, scans_lost = 0;
    for_all(10'000, [&](Rng& rng, int) {
      ++flipped;
      const std::uint64_t offset = rng.bits() % bytes.size();
      const char mask = static_cast<char>(1 << rng.uniform_index(8));
      const Patch patch(folder / "a", offset, static_cast<char>(bytes[offset] ^ mask));
      if (io_error([&] { return load_map(folder / "a"); }).empty()) FAIL_CHECK("accepted: bit of byte ", offset);
      LoadedMap loaded;
      const std::string error = io_error([&] { return loaded = load_map(folder / "a", {.recover = true}), 0; });
      if (!error.empty()) {
        ++refused;
        return;
      }
      ++recovered;
      scans_lost += static_cast<int>(loaded.report.scans_lost.size());
      if (loaded.report.complete || loaded.report.problems.empty() || !is_part(loaded, map))
        FAIL_CHECK("wrong: bit of byte ", offset);
    });
    if (!seed_from_environment()) {
      CHECK(refused < flipped / 5);  // the file's header and what comes before the first commit
      CHECK(recovered > flipped - flipped / 5);
      CHECK(scans_lost > flipped / 100);
    }
    CHECK(read_bytes(folder / "a") == bytes);
  }

  TEST_CASE("bytes behind the end are ignored, and reported") {
    const TemporaryFolder folder;
    const SlamMap map = journal_drive(folder / "a").back().map;
    for (const std::size_t extra : {1U, 64U, 1000U}) {
      write_bytes(folder / "b", read_bytes(folder / "a") + std::string(extra, 'x'));
      CHECK(!io_error([&] { return load_map(folder / "b"); }).empty());
      const LoadedMap loaded = load_map(folder / "b", {.recover = true});
      CHECK(same_map(loaded.map, map));
      CHECK(!loaded.report.complete);
      CHECK(loaded.report.ignored_bytes > extra);
    }
  }

  TEST_CASE("a process that is killed leaves what it had committed, and no lock") {
    const TemporaryFolder folder;
    GrowingMap growing(5);
    const ::pid_t child = ::fork();
    if (child == 0) {
      MapJournal<> journal(folder / "a");
      for (int i = 0; i < 20; ++i) {
        growing.add_keyframe();
        journal.update(growing.map());
      }
      ::raise(SIGKILL);
    }
    int status = 0;
    REQUIRE(::waitpid(child, &status, 0) == child);
    CHECK(WIFSIGNALED(status));
    for (int i = 0; i < 20; ++i) growing.add_keyframe();
    const LoadedMap loaded = load_map(folder / "a.partial", {.recover = true});
    CHECK(same_records(loaded.map.keyframes, growing.map().keyframes));
    CHECK(same_records(loaded.map.closures, growing.map().closures));
    save_map(folder / "a", loaded, true);
    CHECK(load_map(folder / "a").report.complete);
    CHECK(fs::exists(folder / "a.partial~1"));
  }

  TEST_CASE("keyframes that came after the last poses are placed by odometry") {
    const TemporaryFolder folder;
    GrowingMap growing(5);
    {
      MapJournal<> journal(folder / "a");
      for (int i = 0; i < 44; ++i) {
        growing.add_keyframe();
        if (i >= 39) journal.update(growing.map());  // poses at 40; the next at 45
      }
    }
    const LoadedMap loaded = load_map(folder / "a.partial", {.recover = true});
    CHECK(loaded.report.poses_by_odometry == 4);
    for (std::size_t i = 40; i < 44; ++i) {
      const Keyframe &keyframe = loaded.map.keyframes[i], &before = loaded.map.keyframes[i - 1];
      const SE3d step = before.T_odom_body.inverse() * keyframe.T_odom_body;
      CHECK((before.T_map_body * step).local(keyframe.T_map_body).norm() < 1e-9);
    }
    growing.begin_session("second");
    growing.add_keyframe();
    const TemporaryFolder other;
    {
      MapJournal<> journal(other / "a");
      journal.update(growing.map());
      const SE3d first = growing.map().keyframes.back().T_map_body;
      for (int i = 0; i < 3; ++i) growing.add_keyframe();
      growing.begin_session("third");
      growing.add_keyframe();
      journal.update(growing.map());
      CHECK(load_map(journal.partial_path(), {.recover = true}).map.keyframes[44].T_map_body == first);
    }
    const LoadedMap third = load_map(other / "a.partial", {.recover = true});
    CHECK(third.report.poses_by_odometry == 3);
    CHECK(third.map.keyframes.back().T_map_body == growing.map().keyframes.back().T_map_body);
  }

  TEST_CASE("whichever operation of the disk fails, neither the old map nor what was committed is lost") {
    using Operation = FaultyFiles::Operation;
    const SlamMap old = random_map(1, 5);
    const TemporaryFolder first;
    save_map(first / "a", old);
    int failures = 0;
    for (const Operation operation : {Operation::create, Operation::write, Operation::sync, Operation::sync_data,
                                      Operation::rename, Operation::sync_directory, Operation::lock})
      for (const int countdown : {0, 1, 2, 5, 9, 17}) {
        const int error = operation == Operation::write ? ENOSPC : EIO;
        const TemporaryFolder folder;
        write_bytes(folder / "a", read_bytes(first / "a"));
        GrowingMap growing(2);
        SlamMap committed;
        bool finished = false;
        const std::string words = io_error([&] {
          MapJournal<FaultyFiles> journal(folder / "a", {.overwrite = true}, {operation, countdown, error});
          for (int i = 0; i < 8; ++i) {
            growing.add_keyframe();
            journal.update(growing.map());
            committed = growing.map();
          }
          journal.finish(growing.map());
          finished = true;
          return 0;
        });
        CAPTURE(static_cast<int>(operation));
        CAPTURE(countdown);
        CHECK(words.empty() == finished);
        if (finished) {
          CHECK(same_map(load_map(folder / "a").map, growing.map()));
          CHECK(same_map(load_map(folder / "a~1").map, old));
          continue;
        }
        ++failures;
        const bool renamed = fs::exists(folder / "a~1");
        CHECK(same_map(load_map(folder / (renamed ? "a~1" : "a")).map, old));
        if (renamed) {
          CHECK(operation == Operation::sync_directory);  // the new map has its name; only a power cut could undo it
          CHECK(same_map(load_map(folder / "a").map, growing.map()));
        } else if (!committed.keyframes.empty()) {
          CHECK(says(words, "chainslam recover"));
          const SlamMap found = load_map(folder / "a.partial", {.recover = true}).map;
          CHECK((same_map(found, committed) || same_map(found, growing.map())));
        } else {
          CHECK(folder.files() == 1);
        }
      }
    CHECK(failures > 12);
  }

  TEST_CASE("after a failure the journal takes nothing more") {
    using Operation = FaultyFiles::Operation;
    const TemporaryFolder folder;
    GrowingMap growing(2);
    growing.add_keyframe();
    MapJournal<FaultyFiles> journal(folder / "a", {}, {Operation::sync_data, 0, EIO});
    CHECK(!io_error([&] { return journal.update(growing.map()), 0; }).empty());
    CHECK_THROWS_AS(journal.update(growing.map()), std::invalid_argument);
    CHECK_THROWS_AS(journal.finish(growing.map()), std::invalid_argument);
  }
}

}  // namespace chainslam::test
