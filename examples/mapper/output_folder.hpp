#pragma once

#include <filesystem>

namespace chainslam::mapper {

/// A folder of results that appears whole or not at all.
///
/// Results go to `path()`, a folder beside the target; `commit` gives it the target's name. What stands under that name
/// until then is kept: as TARGET~1, TARGET~2, ... if overwriting was allowed. Without a commit the new folder is
/// removed.
class OutputFolder {
 public:
  /// Makes the folder beside the target, parents and all, and tries to write to it, so that a long run does not end in
  /// vain.
  /// @throws IoError if the target holds something and `overwrite` is false, or nothing can be written there.
  OutputFolder(std::filesystem::path target, bool overwrite);
  ~OutputFolder();
  OutputFolder(const OutputFolder&) = delete;
  OutputFolder& operator=(const OutputFolder&) = delete;

  [[nodiscard]] const std::filesystem::path& path() const { return staging_; }
  [[nodiscard]] const std::filesystem::path& target() const { return target_; }

  /// If the results never get their name, the folder stays as it is if it holds this file.
  void keep_unfinished(const std::filesystem::path& name) { kept_if_ = staging_ / name; }

  /// Gives the results the target's name. @returns where the old results went, empty if there were none.
  /// @throws IoError if a folder cannot be renamed; the old results then keep their name.
  std::filesystem::path commit();

 private:
  std::filesystem::path target_;
  std::filesystem::path staging_;
  std::filesystem::path kept_if_;
  bool committed_ = false;
};

}  // namespace chainslam::mapper
