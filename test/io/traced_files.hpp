#pragma once

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/io/file_system.hpp"
#include "support/files.hpp"

namespace chainslam::test {

/// One operation on the disk, as far as a loss of power can tell it from others.
struct DiskOperation {
  enum class Kind { create, write, sync, close, lock, rename, link, remove, sync_directory };
  Kind kind;
  std::string name{};  ///< of the file, in the folder
  std::string to{};    ///< of rename and link
  std::string bytes{};
};

/// The machine's files in one folder, without waiting for the disk. Every operation is recorded, and one of them can be
/// made to fail.
class TracedFiles {
 public:
  static constexpr int short_write = -1;  ///< in place of an errno: a write takes half of its bytes, without an error

  TracedFiles() = default;
  /// @param number  of the operation that fails, from 0; all others are done.
  TracedFiles(int number, int error) {
    state_->fails_at = number;
    state_->error = error;
  }

  [[nodiscard]] const std::vector<DiskOperation>& trace() const { return state_->trace; }
  /// Done or failed, of all kinds.
  [[nodiscard]] int operations() const { return state_->operations; }
  [[nodiscard]] bool failed() const { return state_->failed; }
  /// What kind of operation failed.
  [[nodiscard]] DiskOperation::Kind failed_kind() const { return state_->failed_kind; }

  using Path = std::filesystem::path;
  using Kind = DiskOperation::Kind;

  int create(const Path& path) {
    if (fails(Kind::create)) return -state_->error;
    const int file = real_.create(path);
    if (file >= 0) note({Kind::create, state_->names[file] = path.filename().string()});
    return file;
  }
  std::ptrdiff_t write(int file, const std::byte* data, std::size_t size) {
    size = std::min<std::size_t>(size, 1000);  // many writes, as of a slow disk
    if (fails(Kind::write)) {
      if (state_->error != short_write) return -state_->error;
      size = (size + 1) / 2;
    }
    const std::ptrdiff_t written = real_.write(file, data, size);
    if (written > 0)
      note({Kind::write, state_->names[file], "",
            std::string(reinterpret_cast<const char*>(data), static_cast<std::size_t>(written))});
    return written;
  }
  int sync(int file) { return synced(file); }
  int sync_data(int file) { return synced(file); }
  int lock(int file) { return fails(Kind::lock) ? failure() : real_.lock(file); }
  int close(int file) {
    const int error = real_.close(file);
    return fails(Kind::close) ? failure() : error;
  }
  int rename(const Path& from, const Path& to) {
    if (fails(Kind::rename)) return failure();
    return noted(real_.rename(from, to), {Kind::rename, from.filename().string(), to.filename().string()});
  }
  int rename_new(const Path& from, const Path& to) {
    if (fails(Kind::rename)) return failure();
    return noted(real_.rename_new(from, to), {Kind::rename, from.filename().string(), to.filename().string()});
  }
  int link(const Path& from, const Path& to) {
    if (fails(Kind::link)) return failure();
    return noted(real_.link(from, to), {Kind::link, from.filename().string(), to.filename().string()});
  }
  int sync_directory(const Path& /*path*/) {
    if (fails(Kind::sync_directory)) return failure();
    return noted(0, {Kind::sync_directory});
  }
  int remove(const Path& path) {
    if (fails(Kind::remove)) return failure();
    return noted(real_.remove(path), {Kind::remove, path.filename().string()});
  }

 private:
  struct State {
    std::vector<DiskOperation> trace;
    std::map<int, std::string> names;  // of open files
    int fails_at = -1, error = 0, operations = 0;
    bool failed = false;
    Kind failed_kind{};
  };

  bool fails(Kind kind) {
    const bool now = state_->operations++ == state_->fails_at && (state_->error != short_write || kind == Kind::write);
    if (now) state_->failed_kind = kind;
    state_->failed |= now;
    return now;
  }
  [[nodiscard]] int failure() const { return state_->error; }
  void note(DiskOperation operation) { state_->trace.push_back(std::move(operation)); }
  int noted(int error, DiskOperation operation) {
    if (error == 0) note(std::move(operation));
    return error;
  }
  int synced(int file) {
    if (fails(Kind::sync)) return failure();
    return noted(0, {Kind::sync, state_->names[file]});
  }

  std::shared_ptr<State> state_ = std::make_shared<State>();
  RealFileSystem real_;
};
static_assert(JournalFileSystem<TracedFiles>);

/// What a disk holds after a loss of power, by the operations before it. Files are only ever appended to.
class CutDisk {
 public:
  /// What becomes of what was not synced.
  enum class Unsynced { kept, lost, torn, reordered };

  /// @param before  files that are on the disk, by name.
  CutDisk(const std::map<std::string, std::string>& before, const std::vector<DiskOperation>& trace,
          std::size_t count) {
    for (const auto& [name, bytes] : before) {
      entries_[name] = std::ssize(files_);
      files_.push_back({bytes, bytes.size()});
    }
    durable_ = entries_;
    for (std::size_t i = 0; i < count; ++i) apply(trace[i]);
  }

  /// The files of one possible disk.
  [[nodiscard]] std::map<std::string, std::string> files(Unsynced unsynced, Rng& rng) const {
    std::map<std::string, std::string> found;
    for (const auto& [name, number] : entries_after(unsynced, rng))
      found[name] = content_after(files_[static_cast<std::size_t>(number)], unsynced, rng);
    return found;
  }

 private:
  using Entries = std::map<std::string, std::ptrdiff_t>;
  struct File {
    std::string bytes;
    std::size_t synced = 0;  ///< of the bytes, from the start
  };
  struct Change {
    std::string removed, added;  ///< either may be empty
    std::ptrdiff_t file = -1;
  };

  static void apply(const Change& change, Entries& entries) {
    if (!change.removed.empty()) entries.erase(change.removed);
    if (!change.added.empty()) entries[change.added] = change.file;
  }

  void change(Change one) {
    apply(one, entries_);
    pending_.push_back(std::move(one));
  }

  void apply(const DiskOperation& operation) {
    using Kind = DiskOperation::Kind;
    switch (operation.kind) {
      case Kind::create:
        files_.push_back({});
        change({"", operation.name, std::ssize(files_) - 1});
        break;
      case Kind::write:
        files_[static_cast<std::size_t>(entries_.at(operation.name))].bytes += operation.bytes;
        break;
      case Kind::sync: {
        File& file = files_[static_cast<std::size_t>(entries_.at(operation.name))];
        file.synced = file.bytes.size();
        break;
      }
      case Kind::rename:
        change({operation.name, operation.to, entries_.at(operation.name)});
        break;
      case Kind::link:
        change({"", operation.to, entries_.at(operation.name)});
        break;
      case Kind::remove:
        change({operation.name, "", -1});
        break;
      case Kind::sync_directory:
        durable_ = entries_;
        pending_.clear();
        break;
      case Kind::close:
      case Kind::lock:
        break;
    }
  }

  [[nodiscard]] Entries entries_after(Unsynced unsynced, Rng& rng) const {
    if (unsynced == Unsynced::kept) return entries_;
    Entries entries = durable_;
    const auto kept = static_cast<std::size_t>(rng.uniform_index(static_cast<Index>(pending_.size()) + 1));
    for (std::size_t i = 0; i < pending_.size(); ++i) {
      const bool applied = unsynced == Unsynced::torn        ? i < kept
                           : unsynced == Unsynced::reordered ? rng.uniform_index(2) == 0
                                                             : false;
      if (applied) apply(pending_[i], entries);
    }
    return entries;
  }

  [[nodiscard]] static std::string content_after(const File& file, Unsynced unsynced, Rng& rng) {
    if (unsynced == Unsynced::kept) return file.bytes;
    std::string bytes = file.bytes.substr(0, file.synced);
    std::string rest = file.bytes.substr(file.synced);
    if (unsynced == Unsynced::lost || rest.empty()) return bytes;
    if (unsynced == Unsynced::torn) {
      rest.resize(static_cast<std::size_t>(rng.uniform_index(static_cast<Index>(rest.size()) + 1)));
      for (std::size_t i = rest.size() - std::min<std::size_t>(rest.size(), 100); i < rest.size(); ++i)
        if (rng.uniform_index(2) == 0) rest[i] = static_cast<char>(rng.bits());
      return bytes + rest;
    }
    constexpr std::size_t sector = 512;
    for (std::size_t at = 0; at < rest.size(); at += sector)  // some never came to the disk, whatever came before them
      if (const Index fate = rng.uniform_index(3); fate > 0)
        for (std::size_t i = at; i < std::min(rest.size(), at + sector); ++i)
          rest[i] = fate == 1 ? '\0' : static_cast<char>(rng.bits());
    return bytes + rest;
  }

  std::vector<File> files_;
  Entries entries_, durable_;    ///< as a running system sees them; as the disk has them for sure
  std::vector<Change> pending_;  ///< between the two
};

}  // namespace chainslam::test
