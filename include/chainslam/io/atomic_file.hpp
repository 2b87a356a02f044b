#pragma once

#include <sys/stat.h>
#include <unistd.h>

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
#include "chainslam/io/detail/final_name.hpp"
#include "chainslam/io/file_system.hpp"

namespace chainslam {

/// What becomes of a file that has the name already.
enum class Existing {
  replace,  ///< it goes when the new one is whole
  keep,     ///< it is kept as NAME~1, NAME~2, ...
  refuse    ///< it stays, and nothing is written
};

/// Where a file is to be written. Any path is a target whose old file is replaced.
struct FileTarget {
  /// A file of this name.
  template <std::convertible_to<std::filesystem::path> Path>
  FileTarget(const Path& target, Existing of_old = Existing::replace)  // NOLINT: paths are targets
      : path(target), existing(of_old) {}

  std::filesystem::path path;  ///< its name
  Existing existing;           ///< what becomes of a file that has the name
};

/// A file that appears whole or not at all.
///
/// What is written goes to a temporary beside the target. `commit` flushes it, makes the disk keep it and renames it;
/// until then, and after any failure, the target is as it was and the temporary is removed. A target that is a symbolic
/// link is followed; access rights are kept.
template <class System = RealFileSystem>
class BasicAtomicFile {
  static_assert(FileSystem<System>,
                "BasicAtomicFile: System needs create, write, sync, close, rename, rename_new, link, sync_directory "
                "and remove, as RealFileSystem has them; see chainslam/io/file_system.hpp");

 public:
  /// @throws IoError if the target is no plain file, is there and has to stay, or its folder is missing or cannot be
  /// written.
  explicit BasicAtomicFile(const FileTarget& target, System system = {})
      : target_(followed(target.path)), existing_(target.existing), system_(std::move(system)) {
    static std::atomic<unsigned> serial{0};
    std::error_code ignored;
    const auto kind = std::filesystem::status(target_, ignored).type();
    if (kind != std::filesystem::file_type::not_found && kind != std::filesystem::file_type::regular &&
        kind != std::filesystem::file_type::none)
      throw_output_error(target_.string(), "", "not a plain file (a folder or a device)", "choose a file's name");
    if (existing_ == Existing::refuse && detail::is_taken(target_)) detail::throw_taken(target_);
    do {
      temporary_ = target_;
      temporary_ += ".partial-" + std::to_string(::getpid()) + "-" + std::to_string(serial++);
      file_ = detail::created(system_, temporary_);
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
  /// Appends text. @throws IoError if the disk fails.
  void write(std::string_view text) { write(std::as_bytes(std::span(text))); }

  /// Bytes written so far.
  [[nodiscard]] std::size_t size() const { return sent_ + buffer_.size(); }

  /// Gives the file its name. Nothing may be written after it. @throws IoError; the target is then as it was.
  void commit() {
    flush();
    if (const int error = detail::uninterrupted([&] { return system_.sync(file_); }))
      fail("making the disk keep the file", error);
    // Interrupted, it is closed all the same, and the bytes are on the disk.
    if (const int error = system_.close(std::exchange(file_, -1)); error != 0 && error != EINTR)
      fail("closing the file", error);
    take_name();
    temporary_.clear();
    if (const int error = detail::uninterrupted([&] { return system_.sync_directory(folder()); }))
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

  void take_name() {
    if (existing_ == Existing::replace) {
      if (const int error = detail::uninterrupted([&] { return system_.rename(temporary_, target_); }))
        fail("giving it its name", error);
      return;
    }
    const detail::Naming naming = detail::give_name(system_, temporary_, target_, existing_ == Existing::keep);
    if (naming.error == EEXIST) {
      discard();
      detail::throw_taken(target_);
    }
    if (naming.error != 0) fail(naming.doing, naming.error);
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
  Existing existing_;
  std::filesystem::path temporary_;  ///< empty once renamed or removed
  [[no_unique_address]] System system_;
  int file_ = -1;
  std::size_t sent_ = 0;
  std::vector<std::byte> buffer_;
};

using AtomicFile = BasicAtomicFile<>;

}  // namespace chainslam
