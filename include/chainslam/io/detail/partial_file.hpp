#pragma once

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "chainslam/core/error.hpp"
#include "chainslam/io/detail/final_name.hpp"
#include "chainslam/io/detail/open_to_read.hpp"
#include "chainslam/io/file_system.hpp"
#include "chainslam/io/input_file.hpp"

namespace chainslam::detail {

/// "process 123" that holds a lock on the file, as Linux lists locks: `1: FLOCK ADVISORY WRITE 123 08:01:4711 0 EOF`.
[[nodiscard]] inline std::string lock_holder(const std::filesystem::path& path) {
  struct stat information {};
  if (::stat(path.c_str(), &information) != 0) return "another process";
  const std::string inode = ":" + std::to_string(information.st_ino) + " ";
  try {
    InputFile locks("/proc/locks");
    while (const auto line = locks.read_line()) {
      const auto write = line->find("WRITE ");
      if (line->find("FLOCK") == line->npos || line->find(inode) == line->npos || write == line->npos) continue;
      const std::string_view pid = line->substr(write + 6);
      return "process " + std::string(pid.substr(0, pid.find(' ')));
    }
  } catch (const IoError&) {  // a system without that list
  }
  return "another process";
}

/// A file that grows as TARGET.partial under one writer's lock and gets its name when it is finished.
///
/// What `sync` has returned from survives. A file that was never synced is removed; one that was stays, under its
/// partial name, until `finish`. After a failure nothing more can be written.
template <class Files>
class PartialFile {
 public:
  /// @throws IoError if the target exists and `overwrite` is false; if another writer has the partial file; if one was
  /// left by a run that did not finish (with `overwrite` it is kept as TARGET.partial~1); or if it cannot be made.
  PartialFile(std::filesystem::path target, bool overwrite, Files files)
      : target_(std::move(target)), partial_(target_), overwrite_(overwrite), files_(std::move(files)) {
    partial_ += ".partial";
    require_free_target();
    file_ = created(files_, partial_);
    if (file_ == -EEXIST) {
      set_leftover_aside();
      file_ = created(files_, partial_);
    }
    if (file_ < 0) fail("creating the file", -std::exchange(file_, -1));
    if (const int error = uninterrupted([&] { return files_.lock(file_); })) {
      files_.close(std::exchange(file_, -1));
      if (error == EWOULDBLOCK) throw_locked();
      files_.remove(partial_);
      fail("locking the file", error);
    }
    buffer_.reserve(buffer_size);
  }

  PartialFile(const PartialFile&) = delete;
  PartialFile& operator=(const PartialFile&) = delete;
  ~PartialFile() {
    if (file_ < 0) return;
    if (!synced_) files_.remove(partial_);
    files_.close(file_);
  }

  /// Bytes written so far.
  [[nodiscard]] std::uint64_t size() const { return sent_ + buffer_.size(); }
  [[nodiscard]] const std::filesystem::path& target() const { return target_; }
  [[nodiscard]] const std::filesystem::path& partial() const { return partial_; }
  [[nodiscard]] bool writable() const { return file_ >= 0 && !broken_; }

  /// A descriptor that reads the file, which the caller closes. @throws IoError
  [[nodiscard]] int open_to_read() const {
    const int file = detail::open_to_read(partial_);
    if (file < 0)
      throw_output_error(partial_.string(), "opening it to be read", reason(errno), output_remedy(errno, folder()));
    return file;
  }

  void write(std::span<const std::byte> bytes) {
    if (buffer_.size() + bytes.size() > buffer_size) flush();
    if (bytes.size() >= buffer_size)
      send(bytes);
    else
      buffer_.insert(buffer_.end(), bytes.begin(), bytes.end());
  }

  /// Gives the system what was written, for readers and against a crash of the program. @throws IoError
  void flush() {
    send(buffer_);
    buffer_.clear();
  }

  /// Makes the disk keep what was written. @throws IoError
  void sync() {
    flush();
    if (const int error = uninterrupted([&] { return files_.sync_data(file_); }))
      fail("making the disk keep the file", error);
    if (!synced_)
      if (const int error = uninterrupted([&] { return files_.sync_directory(folder()); }))
        fail("making the disk keep the folder's entry", error);
    synced_ = true;
  }

  /// Deletes the file. Nothing can follow.
  void remove() {
    if (file_ < 0) return;
    files_.remove(partial_);
    files_.close(std::exchange(file_, -1));
  }

  /// Gives the file its name; what had it is kept as TARGET~1. @throws IoError; the partial file then stays.
  void finish() {
    sync();
    if (const int error = uninterrupted([&] { return files_.sync(file_); }))
      fail("making the disk keep the file", error);
    const Naming naming = give_name(files_, partial_, target_, overwrite_);
    if (naming.error == EEXIST) throw_taken(target_);
    if (naming.error != 0) fail(naming.doing, naming.error);
    files_.close(std::exchange(file_, -1));  // the lock ends here; the bytes are on the disk already
    if (const int error = uninterrupted([&] { return files_.sync_directory(folder()); }))
      throw_output_error(target_.string(), "making the disk keep the folder's entry", reason(error),
                         "the file is whole and has its name, but a power cut now could undo that: check the disk");
  }

 private:
  static constexpr std::size_t buffer_size = std::size_t{1} << 18;

  static std::string reason(int error) { return std::generic_category().message(error); }

  std::filesystem::path folder() const {
    return target_.has_parent_path() ? target_.parent_path() : std::filesystem::path(".");
  }

  void require_free_target() const {
    std::error_code error;
    if (std::filesystem::is_directory(target_, error))
      throw_output_error(target_.string(), "", "a folder", "choose a file's name");
    if (!overwrite_ && is_taken(target_)) throw_taken(target_);
  }

  [[noreturn]] void throw_locked() const {
    throw_output_error(partial_.string(), "", lock_holder(partial_) + " is writing this map",
                       "wait until it has finished, or choose another name");
  }

  /// The partial file of a run that did not finish is never written over.
  void set_leftover_aside() {
    const int leftover = detail::open_to_read(partial_);
    if (leftover < 0) fail("looking at the file that is there", errno);
    const bool taken = ::flock(leftover, LOCK_EX | LOCK_NB) != 0 && errno == EWOULDBLOCK;
    ::close(leftover);
    if (taken) throw_locked();
    const std::filesystem::path kept = kept_name(partial_);
    if (!overwrite_)
      throw_output_error(partial_.string(), "", "what a run left that did not finish",
                         "save it by `chainslam recover`, or remove it; or allow overwriting: it is then kept as " +
                             printable(kept.filename().native()));
    if (const int error = uninterrupted([&] { return files_.rename_new(partial_, kept); }))
      fail("keeping it as " + kept.string(), error);
  }

  void send(std::span<const std::byte> bytes) {
    while (!bytes.empty()) {
      const std::ptrdiff_t written = files_.write(file_, bytes.data(), bytes.size());
      if (written == -EINTR) continue;
      // A disk may take nothing and set no error number; it is full all the same.
      if (written <= 0) fail("byte " + std::to_string(sent_), written == 0 ? ENOSPC : static_cast<int>(-written));
      sent_ += static_cast<std::uint64_t>(written);
      bytes = bytes.subspan(static_cast<std::size_t>(written));
    }
  }

  [[noreturn]] void fail(const std::string& place, int error) {
    broken_ = true;  // after a failed sync the system may have dropped what it could not write: never try again
    const std::string saved = synced_ ? "; what had been committed is kept: `chainslam recover " +
                                            printable(partial_.native()) + " -o NEW.cslam` saves it"
                                      : "";
    throw_output_error(target_.string(), place, reason(error), output_remedy(error, folder()) + saved);
  }

  std::filesystem::path target_;
  std::filesystem::path partial_;
  bool overwrite_;
  [[no_unique_address]] Files files_;
  int file_ = -1;
  bool synced_ = false;
  bool broken_ = false;
  std::uint64_t sent_ = 0;
  std::vector<std::byte> buffer_;
};

}  // namespace chainslam::detail
