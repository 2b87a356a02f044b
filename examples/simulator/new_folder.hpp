#pragma once

#include <cstdint>
#include <filesystem>
#include <system_error>
#include <vector>

#include "chainslam/core/error.hpp"

namespace chainslam::simulator {

/// A folder that was empty: what has been finished in it goes again unless all was.
class NewFolder {
 public:
  explicit NewFolder(const std::filesystem::path& path) : path_(path) {
    std::error_code error;
    std::filesystem::create_directories(path, error);
    if (error) throw_output_error(path.string(), "", error.message(), "choose a folder that can be made");
    if (!std::filesystem::is_empty(path, error) || error)
      throw_output_error(path.string(), "", error ? error.message() : "a folder that is not empty",
                         "name a new or empty folder; nothing in it was changed");
  }
  NewFolder(const NewFolder&) = delete;
  NewFolder& operator=(const NewFolder&) = delete;
  ~NewFolder() {
    if (whole_) return;
    std::error_code ignored;
    for (; !parts_.empty(); parts_.pop_back()) std::filesystem::remove(parts_.back(), ignored);
  }

  /// A file or folder to be made in it.
  std::filesystem::path part(const std::filesystem::path& name) { return parts_.emplace_back(path_ / name); }
  /// All that was made, folders before what is in them; more may be added.
  [[nodiscard]] std::vector<std::filesystem::path>& parts() { return parts_; }

  /// Bytes in all files, which stay from now on.
  std::uint64_t keep() {
    whole_ = true;
    std::uint64_t bytes = 0;
    for (const std::filesystem::path& part : parts_)
      bytes += std::filesystem::is_regular_file(part) ? std::filesystem::file_size(part) : 0;
    return bytes;
  }

 private:
  std::filesystem::path path_;
  std::vector<std::filesystem::path> parts_;
  bool whole_ = false;
};

}  // namespace chainslam::simulator
