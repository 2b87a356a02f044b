#pragma once

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <concepts>
#include <cstddef>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <system_error>
#include <utility>
#include <vector>

#include "chainslam/core/error.hpp"

namespace chainslam {

/// The few operations that a safe write needs, so that tests can make each of them fail.
///
/// `create` makes a file that did not exist and gives its number, `write` gives the bytes taken; both give -errno on
/// failure. The others give 0 or errno. Nothing throws. Copies share one file system.
template <class System>
concept FileSystem = std::copyable<System> &&
    requires(System& system, const std::filesystem::path& path, int file, const std::byte* data) {
  { system.create(path) } -> std::same_as<int>;
  { system.write(file, data, std::size_t{}) } -> std::same_as<std::ptrdiff_t>;
  { system.sync(file) } -> std::same_as<int>;
  { system.close(file) } -> std::same_as<int>;
  { system.rename(path, path) } -> std::same_as<int>;
  { system.sync_directory(path) } -> std::same_as<int>;
  { system.remove(path) } -> std::same_as<int>;
};

/// A file system whose files can also grow safely under one writer: `sync_data` makes the disk keep a file's bytes and
/// length, `lock` takes the file for this writer until it is closed. Both give 0 or errno (EWOULDBLOCK: taken).
template <class System>
concept JournalFileSystem = FileSystem<System> && requires(System& system, int file) {
  { system.sync_data(file) } -> std::same_as<int>;
  { system.lock(file) } -> std::same_as<int>;
};

/// The machine's own files.
struct RealFileSystem {
  int create(const std::filesystem::path& path) {
    const int file = ::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    return file >= 0 ? file : -errno;
  }
  std::ptrdiff_t write(int file, const std::byte* data, std::size_t size) {
    const ssize_t written = ::write(file, data, size);
    return written >= 0 ? written : -errno;
  }
  int sync(int file) { return ::fsync(file) == 0 ? 0 : errno; }
  int sync_data(int file) { return ::fdatasync(file) == 0 ? 0 : errno; }
  int lock(int file) { return ::flock(file, LOCK_EX | LOCK_NB) == 0 ? 0 : errno; }
  int close(int file) { return ::close(file) == 0 ? 0 : errno; }
  int rename(const std::filesystem::path& from, const std::filesystem::path& to) {
    return ::rename(from.c_str(), to.c_str()) == 0 ? 0 : errno;
  }
  int sync_directory(const std::filesystem::path& directory) {
    const int file = ::open(directory.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (file < 0) return errno;
    const int error = sync(file);
    ::close(file);
    // Some network file systems cannot sync a directory and say so: the rename is then as safe as they make it.
    return error == EINVAL || error == ENOTSUP ? 0 : error;
  }
  int remove(const std::filesystem::path& path) { return ::unlink(path.c_str()) == 0 ? 0 : errno; }
};
static_assert(FileSystem<RealFileSystem> && JournalFileSystem<RealFileSystem>);

namespace detail {

/// What a user can do about an error number met while writing.
inline std::string output_remedy(int error, const std::filesystem::path& directory) {
  switch (error) {
    case ENOSPC:
    case EDQUOT:
      return "free space or choose another folder; nothing under the file's own name was changed";
    case EROFS:
    case EACCES:
    case EPERM:
      return "choose a folder that you may write to; '" + directory.string() + "' refuses";
    case ENOENT:
      return "create the folder '" + directory.string() + "' first";
    case ENOTDIR:
      return "'" + directory.string() + "' is not a folder: choose another output path";
    case EFBIG:
      return "raise the limit on file sizes (ulimit -f) or choose another file system";
    case ENAMETOOLONG:
      return "choose a shorter name";
    default:
      return "check the disk and try again; nothing under the file's own name was changed";
  }
}

}  // namespace detail

/// A file that appears whole or not at all.
///
/// What is written goes to a temporary beside the target. `commit` flushes it, makes the disk keep it and renames it;
/// until then, and after any failure, the target is as it was and the temporary is removed. A target that is a symbolic
/// link is followed; its access rights are kept.
template <class System = RealFileSystem>
class BasicAtomicFile {
  static_assert(FileSystem<System>,
                "BasicAtomicFile: System needs create, write, sync, close, rename, sync_directory "
                "and remove, as RealFileSystem has them");

 public:
  /// @throws IoError if the target is no plain file or its folder is missing or cannot be written.
  explicit BasicAtomicFile(std::filesystem::path target, System system = {})
      : target_(followed(std::move(target))), system_(std::move(system)) {
    static std::atomic<unsigned> serial{0};
    std::error_code ignored;
    const auto kind = std::filesystem::status(target_, ignored).type();
    if (kind != std::filesystem::file_type::not_found && kind != std::filesystem::file_type::regular &&
        kind != std::filesystem::file_type::none)
      throw_output_error(target_.string(), "", "not a plain file (a folder or a device)", "choose a file's name");
    do {
      temporary_ = target_;
      temporary_ += ".partial-" + std::to_string(::getpid()) + "-" + std::to_string(serial++);
      file_ = system_.create(temporary_);
    } while (file_ == -EEXIST);
    if (file_ < 0) fail("creating the file", -std::exchange(file_, -1));
    if (kind == std::filesystem::file_type::regular)
      std::filesystem::permissions(temporary_, std::filesystem::status(target_, ignored).permissions(), ignored);
    buffer_.reserve(buffer_size);
  }

  BasicAtomicFile(const BasicAtomicFile&) = delete;
  BasicAtomicFile& operator=(const BasicAtomicFile&) = delete;
  ~BasicAtomicFile() { discard(); }

  /// Appends bytes. @throws IoError when the disk does not take them.
  void write(std::span<const std::byte> bytes) {
    if (bytes.size() >= buffer_size) {
      flush();
      send(bytes);
      return;
    }
    if (buffer_.size() + bytes.size() > buffer_size) flush();
    buffer_.insert(buffer_.end(), bytes.begin(), bytes.end());
  }
  void write(std::string_view text) { write(std::as_bytes(std::span(text))); }

  /// Bytes written so far.
  [[nodiscard]] std::size_t size() const { return sent_ + buffer_.size(); }

  /// Gives the file its name. Nothing may be written after it. @throws IoError; the target is then as it was.
  void commit() {
    flush();
    if (const int error = system_.sync(file_)) fail("making the disk keep the file", error);
    if (const int error = system_.close(std::exchange(file_, -1))) fail("closing the file", error);
    if (const int error = system_.rename(temporary_, target_)) fail("giving the file its name", error);
    temporary_.clear();
    if (const int error = system_.sync_directory(folder()))
      throw_output_error(target_.string(), "making the disk keep the folder's entry", reason(error),
                         "the file is whole and has its name, but a power cut now could undo that: check the disk");
  }

 private:
  static constexpr std::size_t buffer_size = std::size_t{1} << 16;

  static std::filesystem::path followed(std::filesystem::path path) {
    std::error_code error;
    for (int links = 0; links < 32 && std::filesystem::is_symlink(path, error); ++links) {
      const auto next = std::filesystem::read_symlink(path, error);
      path = next.is_absolute() ? next : path.parent_path() / next;
    }
    return path;
  }

  static std::string reason(int error) { return std::generic_category().message(error); }

  std::filesystem::path folder() const {
    return target_.has_parent_path() ? target_.parent_path() : std::filesystem::path(".");
  }

  void flush() {
    send(buffer_);
    buffer_.clear();
  }

  void send(std::span<const std::byte> bytes) {
    while (!bytes.empty()) {
      const std::ptrdiff_t written = system_.write(file_, bytes.data(), bytes.size());
      if (written == -EINTR) continue;
      // A disk may take nothing and set no error number; it is full all the same.
      if (written <= 0) fail("byte " + std::to_string(sent_), written == 0 ? ENOSPC : static_cast<int>(-written));
      sent_ += static_cast<std::size_t>(written);
      bytes = bytes.subspan(static_cast<std::size_t>(written));
    }
  }

  [[noreturn]] void fail(const std::string& place, int error) {
    discard();
    throw_output_error(target_.string(), place, reason(error), detail::output_remedy(error, folder()));
  }

  void discard() {
    if (file_ >= 0) system_.close(std::exchange(file_, -1));
    if (!temporary_.empty()) system_.remove(temporary_);
    temporary_.clear();
  }

  std::filesystem::path target_;
  std::filesystem::path temporary_;  ///< empty once renamed or removed
  [[no_unique_address]] System system_;
  int file_ = -1;
  std::size_t sent_ = 0;
  std::vector<std::byte> buffer_;
};

using AtomicFile = BasicAtomicFile<>;

}  // namespace chainslam
