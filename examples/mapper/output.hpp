#pragma once

#include <cstdio>
#include <exception>
#include <filesystem>
#include <mutex>
#include <string>
#include <vector>

#include "chainslam/io/atomic_file.hpp"

namespace chainslam::mapper {

/// What would make a verb work in vain: throws if something has a result's name, unless it may be set aside.
/// @throws IoError; an empty path is no result.
void require_free(const std::filesystem::path& path, bool overwrite);

/// Writes the results of a verb one by one: each appears whole or not at all, one that cannot be written is reported
/// and the others are still written. All verbs write through this.
class Output {
 public:
  /// @param overwrite  whether what has a result's name is kept as NAME~1; else it stays, and the result is refused.
  explicit Output(bool overwrite) : existing_(overwrite ? Existing::keep : Existing::refuse) {}

  /// Calls `write` with the target. @returns whether it was written.
  template <class Write>
  bool file(const std::filesystem::path& path, const Write& write) {
    return guarded(path, [&] { write(FileTarget(path, existing_)); });
  }

  /// Calls `write`, which writes `path` in whatever way. @returns whether it did.
  template <class Write>
  bool guarded(const std::filesystem::path& path, const Write& write) {
    try {
      write();
    } catch (const std::exception& error) {
      report(path, error);
      return false;
    }
    written_.push_back(path);
    return true;
  }

  [[nodiscard]] const std::vector<std::filesystem::path>& written() const { return written_; }
  /// What to tell the shell where all else would be `otherwise`.
  [[nodiscard]] int exit_code(int otherwise) const;

 private:
  void report(const std::filesystem::path& path, const std::exception& error);

  Existing existing_;
  std::vector<std::filesystem::path> written_;
  std::size_t failures_ = 0;
};

/// A new folder of results. Until `commit` it stands beside the target, as TARGET.partial; `commit` gives it the
/// target's name, and what had that is kept as TARGET~1, TARGET~2, ... if overwriting was allowed. Files may be written
/// before and after.
///
/// Without a commit the folder goes with the files that were written through it; if it holds anything else, that stays.
class OutputFolder {
 public:
  /// Makes the folder beside the target, parents and all, and tries to write to it, so that a long run does not end in
  /// vain. A target that is a symbolic link is followed.
  /// @throws IoError if the target holds something and `overwrite` is false, or nothing can be written there.
  OutputFolder(std::filesystem::path target, bool overwrite);
  ~OutputFolder();
  OutputFolder(const OutputFolder&) = delete;
  OutputFolder& operator=(const OutputFolder&) = delete;

  /// Where the folder is now.
  [[nodiscard]] const std::filesystem::path& path() const { return committed_ ? target_ : staging_; }
  [[nodiscard]] const std::filesystem::path& target() const { return target_; }

  /// Calls `write` with the target of a file in the folder. @returns whether it was written; if not, that is reported.
  template <class Write>
  bool file(const std::string& name, const Write& write) {
    return output_.file(path() / name, write);
  }

  /// Without a commit all that is in the folder goes: for results that are of no use in part. The folder was made by
  /// this run alone, under a name that nothing had.
  void drop_all_unless_committed() { drops_all_ = true; }

  /// Gives the folder the target's name. @returns where the old results went, empty if there were none.
  /// @throws IoError if a folder cannot be renamed; the old results then keep their name, and the new ones stay where
  /// they are.
  std::filesystem::path commit();

  /// @copydoc Output::exit_code
  [[nodiscard]] int exit_code(int otherwise) const { return output_.exit_code(otherwise); }

 private:
  std::filesystem::path target_;
  std::filesystem::path staging_;
  bool overwrite_;
  bool committed_ = false;
  bool drops_all_ = false;
  bool keeps_all_ = false;
  Output output_{false};
};

/// The folder of results that this process has begun and not committed; empty if there is none.
struct BegunFolder {
  std::unique_lock<std::mutex> lock;  ///< while it is held, the folder is not committed
  std::filesystem::path path;
};

/// For whoever ends the program from another thread, and leaves nothing begun.
[[nodiscard]] BegunFolder begun_folder();

}  // namespace chainslam::mapper
