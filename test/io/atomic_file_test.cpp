#include "chainslam/io/atomic_file.hpp"

#include <doctest/doctest.h>
#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <memory>
#include <string_view>
#include <vector>

#include "support/files.hpp"

namespace chainslam::test {
namespace {

/// Fails at the n-th call of one kind, after having done the others for real.
class FaultyFileSystem {
 public:
  enum class Operation { create, write, sync, close, rename, sync_directory, none };

  FaultyFileSystem() = default;
  FaultyFileSystem(Operation operation, int countdown, int error) : state_(std::make_shared<State>()) {
    *state_ = {operation, countdown, error};
  }

  int create(const std::filesystem::path& path) {
    return fails(Operation::create) ? -state_->error : real_.create(path);
  }
  std::ptrdiff_t write(int file, const std::byte* data, std::size_t size) {
    // A full disk takes a part first, then nothing.
    if (fails(Operation::write)) return -state_->error;
    return real_.write(file, data, std::min<std::size_t>(size, 1000));
  }
  int sync(int file) { return fails(Operation::sync) ? state_->error : real_.sync(file); }
  int close(int file) {
    const int error = real_.close(file);
    return fails(Operation::close) ? state_->error : error;
  }
  int rename(const std::filesystem::path& from, const std::filesystem::path& to) {
    return fails(Operation::rename) ? state_->error : real_.rename(from, to);
  }
  int rename_new(const std::filesystem::path& from, const std::filesystem::path& to) {
    return fails(Operation::rename) ? state_->error : real_.rename_new(from, to);
  }
  int link(const std::filesystem::path& from, const std::filesystem::path& to) { return real_.link(from, to); }
  int sync_directory(const std::filesystem::path& path) {
    return fails(Operation::sync_directory) ? state_->error : real_.sync_directory(path);
  }
  int remove(const std::filesystem::path& path) { return real_.remove(path); }

 private:
  struct State {
    Operation operation = Operation::none;
    int countdown = 0;
    int error = 0;
  };

  bool fails(Operation operation) { return state_ && state_->operation == operation && state_->countdown-- == 0; }

  std::shared_ptr<State> state_;
  RealFileSystem real_;
};
static_assert(FileSystem<FaultyFileSystem>);
static_assert(!FileSystem<int>);

std::string write_faulty(const std::filesystem::path& path, const FaultyFileSystem& system) {
  return io_error([&] {
    BasicAtomicFile<FaultyFileSystem> file(path, system);
    for (int i = 0; i < 300; ++i) file.write(std::string(700, 'n'));
    file.commit();
    return 0;
  });
}

}  // namespace

TEST_SUITE("io/atomic_file") {
  TEST_CASE("a file is made once, also where its descriptor is the number of an interruption") {
    std::vector<int> lower;  // open, so that EINTR is the next
    do lower.push_back(::dup(0));
    while (lower.back() <= EINTR);
    const int other = ::fcntl(EINTR, F_DUPFD_CLOEXEC, EINTR + 1);
    ::close(EINTR);
    {
      const TemporaryFolder folder;
      AtomicFile file(folder / "a");
      file.write(std::string_view("text"));
      CHECK(folder.files() == 1);
      file.commit();
      CHECK(folder.files() == 1);
      CHECK(read_bytes(folder / "a") == "text");
    }
    ::dup2(other, EINTR);
    ::close(other);
    for (const int file : lower) ::close(file);
  }

  TEST_CASE("a committed file holds all that was written and leaves no temporary") {
    const TemporaryFolder folder;
    AtomicFile file(folder / "a.txt");
    file.write("small ");
    file.write(std::string(200'000, 'x'));
    file.write(" end");
    CHECK(file.size() == 200'010);
    CHECK(!std::filesystem::exists(folder / "a.txt"));
    file.commit();
    CHECK(read_bytes(folder / "a.txt") == "small " + std::string(200'000, 'x') + " end");
    CHECK(folder.files() == 1);
  }

  TEST_CASE("a file that is not committed never appears") {
    const TemporaryFolder folder;
    write_bytes(folder / "a.txt", "old");
    { AtomicFile(folder / "a.txt").write("new"); }
    CHECK(read_bytes(folder / "a.txt") == "old");
    CHECK(folder.files() == 1);
  }

  TEST_CASE("the old file stays whole whichever write, sync, close or rename fails") {
    using Operation = FaultyFileSystem::Operation;
    for (const Operation operation :
         {Operation::create, Operation::write, Operation::sync, Operation::close, Operation::rename})
      for (const int countdown : {0, 1, 57}) {
        const TemporaryFolder folder;
        write_bytes(folder / "map", "the old map");
        const std::string error = write_faulty(folder / "map", {operation, countdown, EIO});
        if (countdown > 0 && operation != Operation::write) {
          CHECK(error.empty());
          CHECK(read_bytes(folder / "map") == std::string(210'000, 'n'));
        } else {
          CHECK(says(error, (folder / "map").string()));
          CHECK(read_bytes(folder / "map") == "the old map");
        }
        CHECK(folder.files() == 1);
      }
  }

  TEST_CASE("a folder that cannot be synced is reported, and the file is there") {
    using Operation = FaultyFileSystem::Operation;
    const TemporaryFolder folder;
    CHECK(says(write_faulty(folder / "map", {Operation::sync_directory, 0, EIO}), "power cut"));
    CHECK(read_bytes(folder / "map").size() == 210'000);
    CHECK(folder.files() == 1);
  }

  TEST_CASE("a full disk is named, also when the write sets no error number") {
    using Operation = FaultyFileSystem::Operation;
    const TemporaryFolder folder;
    for (const int error : {ENOSPC, 0}) {
      const std::string words = write_faulty(folder / "map", {Operation::write, 3, error});
      CHECK(says(words, "No space left"));
      CHECK(says(words, "free space"));
      CHECK(folder.files() == 0);
    }
  }

  TEST_CASE("the device that is always full fails as a full disk does") {
    RealFileSystem system;
    const int full = ::open("/dev/full", O_WRONLY);
    if (full < 0) return;
    const std::byte byte{1};
    CHECK(system.write(full, &byte, 1) == -ENOSPC);
    system.close(full);
  }

  TEST_CASE("an interrupted write goes on") {
    using Operation = FaultyFileSystem::Operation;
    const TemporaryFolder folder;
    CHECK(write_faulty(folder / "map", {Operation::write, 5, EINTR}).empty());
    CHECK(read_bytes(folder / "map") == std::string(210'000, 'n'));
  }

  TEST_CASE("missing folders, files used as folders, folders and devices as targets are told apart") {
    const TemporaryFolder folder;
    write_bytes(folder / "plain", "x");
    CHECK(says(io_error([&] { return AtomicFile(folder / "none/a").size(); }), "create the folder"));
    CHECK(says(io_error([&] { return AtomicFile(folder / "plain/a").size(); }), "is not a folder"));
    CHECK(says(io_error([&] { return AtomicFile(folder.path()).size(); }), "not a plain file"));
    CHECK(says(io_error([&] { return AtomicFile("/dev/null").size(); }), "not a plain file"));
    CHECK(!io_error([&] { return AtomicFile("/proc/chainslam").size(); }).empty());
    try {
      AtomicFile(folder / "none/a");
    } catch (const IoError& error) {
      CHECK(error.kind() == IoError::Kind::output);
    }
  }

  TEST_CASE("links are followed and access rights kept") {
    const TemporaryFolder folder;
    write_bytes(folder / "real", "old");
    std::filesystem::permissions(folder / "real",
                                 std::filesystem::perms::owner_read | std::filesystem::perms::owner_write);
    std::filesystem::create_symlink("real", folder / "link");
    AtomicFile file(folder / "link");
    file.write("new");
    file.commit();
    CHECK(std::filesystem::is_symlink(folder / "link"));
    CHECK(read_bytes(folder / "real") == "new");
    CHECK(std::filesystem::status(folder / "real").permissions() ==
          (std::filesystem::perms::owner_read | std::filesystem::perms::owner_write));
  }
}

}  // namespace chainslam::test
