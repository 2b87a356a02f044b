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
#include <cstdint>
#include <cstdio>
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
/// failure. The others give 0 or errno. `rename` replaces what has the new name, `rename_new` gives EEXIST instead,
/// `link` gives a file a second name (EEXIST, or an error where the disk has no such names). Nothing throws. Copies
/// share one file system.
template <class System>
concept FileSystem = std::copyable<System> &&
    requires(System& system, const std::filesystem::path& path, int file, const std::byte* data) {
  { system.create(path) } -> std::same_as<int>;
  { system.write(file, data, std::size_t{}) } -> std::same_as<std::ptrdiff_t>;
  { system.sync(file) } -> std::same_as<int>;
  { system.close(file) } -> std::same_as<int>;
  { system.rename(path, path) } -> std::same_as<int>;
  { system.rename_new(path, path) } -> std::same_as<int>;
  { system.link(path, path) } -> std::same_as<int>;
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
  /// Makes a new file; its descriptor, or -1 with errno.
  int create(const std::filesystem::path& path) {
    const int file = ::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    return file >= 0 ? file : -errno;
  }
  /// Writes some of the bytes; how many, or -1 with errno.
  std::ptrdiff_t write(int file, const std::byte* data, std::size_t size) {
    const ssize_t written = ::write(file, data, size);
    return written >= 0 ? written : -errno;
  }
  int sync(int file) { return ::fsync(file) == 0 ? 0 : errno; }  ///< makes the disk keep a file; 0 or errno
  /// Makes the disk keep a file's data; 0 or errno.
  int sync_data(int file) { return ::fdatasync(file) == 0 ? 0 : errno; }
  /// Locks a file against other processes; 0 or errno.
  int lock(int file) { return ::flock(file, LOCK_EX | LOCK_NB) == 0 ? 0 : errno; }
  int close(int file) { return ::close(file) == 0 ? 0 : errno; }  ///< closes a file; 0 or errno
  /// Renames, in place of what has the name; 0 or errno.
  int rename(const std::filesystem::path& from, const std::filesystem::path& to) {
    return ::rename(from.c_str(), to.c_str()) == 0 ? 0 : errno;
  }
  /// Renames unless the name is taken; 0 or errno.
  int rename_new(const std::filesystem::path& from, const std::filesystem::path& to) {
#ifdef RENAME_NOREPLACE
    if (::renameat2(AT_FDCWD, from.c_str(), AT_FDCWD, to.c_str(), RENAME_NOREPLACE) == 0) return 0;
    if (errno != EINVAL && errno != ENOSYS) return errno;  // some network file systems cannot
#endif
    struct stat information {};
    if (::lstat(to.c_str(), &information) == 0) return EEXIST;
    return rename(from, to);
  }
  /// Gives a file a second name; 0 or errno.
  int link(const std::filesystem::path& from, const std::filesystem::path& to) {
    return ::link(from.c_str(), to.c_str()) == 0 ? 0 : errno;
  }
  /// Makes the disk keep a folder's names; 0 or errno.
  int sync_directory(const std::filesystem::path& directory) {
    const int file = ::open(directory.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (file < 0) return errno;
    const int error = sync(file);
    ::close(file);
    // Some network file systems cannot sync a directory and say so: the rename is then as safe as they make it.
    return error == EINVAL || error == ENOTSUP ? 0 : error;
  }
  /// Removes a name; 0 or errno.
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
      return "choose a folder that you may write to; '" + printable(directory.native()) + "' refuses";
    case ENOENT:
      return "create the folder '" + printable(directory.native()) + "' first";
    case ENOTDIR:
      return "'" + printable(directory.native()) + "' is not a folder: choose another output path";
    case EFBIG:
      return "raise the limit on file sizes (ulimit -f) or choose another file system";
    case ENAMETOOLONG:
      return "choose a shorter name";
    default:
      return "check the disk and try again; nothing under the file's own name was changed";
  }
}

/// Does an operation again as long as a signal interrupts it. What it gives is 0 or errno.
template <class Operation>
int uninterrupted(const Operation& operation) {
  int result = operation();
  while (result == EINTR) result = operation();
  return result;
}

/// Makes a new file, again as long as a signal interrupts that. @returns its descriptor, or -errno.
template <class System>
int created(System& system, const std::filesystem::path& path) {
  int file = system.create(path);
  while (file == -EINTR) file = system.create(path);  // EINTR without its sign is a descriptor
  return file;
}

}  // namespace detail

/// Packs bytes and unpacks them again.
///
/// `C::id` is the number that files name it by. `decompress` fills `out`, whose size the caller has already checked, to
/// its last byte; false if the data are damaged or hold another number of bytes. It takes memory for no more than `out`
/// and never reads or writes outside. The same bytes are packed the same way by the same version of the codec.
template <class C>
concept Codec = std::copyable<C> && requires(const C& codec, std::span<const std::byte> in, std::span<std::byte> out) {
  { C::id } -> std::convertible_to<std::uint32_t>;
  { codec.compress(in) } -> std::same_as<std::vector<std::byte>>;
  { codec.decompress(in, out) } -> std::same_as<bool>;
};

/// Keeps bytes as they are.
struct RawCodec {
  static constexpr std::uint32_t id = 0;  ///< 0 in a chunk's header

  /// A copy.
  [[nodiscard]] std::vector<std::byte> compress(std::span<const std::byte> in) const { return {in.begin(), in.end()}; }
  /// Copies; false unless the sizes agree.
  [[nodiscard]] bool decompress(std::span<const std::byte> in, std::span<std::byte> out) const {
    if (in.size() != out.size()) return false;
    std::copy(in.begin(), in.end(), out.begin());
    return true;
  }
};
static_assert(Codec<RawCodec>);

}  // namespace chainslam
