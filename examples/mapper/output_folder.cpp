#include "output_folder.hpp"

#include <string>
#include <system_error>
#include <utility>

#include "chainslam/core/error.hpp"
#include "chainslam/io/file_system.hpp"

namespace chainslam::mapper {

namespace fs = std::filesystem;

namespace {

[[noreturn]] void fail(const fs::path& path, const std::error_code& error, const std::string& remedy) {
  throw_output_error(path.string(), "", error.message(), remedy);
}

bool holds_something(const fs::path& path) {
  std::error_code error;
  if (!fs::exists(fs::symlink_status(path, error))) return false;
  return !fs::is_directory(path, error) || !fs::is_empty(path, error);
}

/// The first of PATH~1, PATH~2, ... that is free.
fs::path free_name(const fs::path& path) {
  for (int number = 1;; ++number) {
    fs::path candidate = path;
    candidate += "~" + std::to_string(number);
    if (!fs::exists(fs::symlink_status(candidate))) return candidate;
  }
}

/// A trailing slash would make `parent_path` the folder itself.
fs::path without_trailing_slash(const fs::path& path) {
  const fs::path absolute = fs::absolute(path).lexically_normal();
  return absolute.has_filename() ? absolute : absolute.parent_path();
}

}  // namespace

OutputFolder::OutputFolder(fs::path target, bool overwrite) : target_(without_trailing_slash(target)) {
  if (!overwrite && holds_something(target_))
    throw_output_error(target_.string(), "", "something is there already",
                       "choose another folder, or pass --overwrite: what is there is then kept as " +
                           free_name(target_).filename().string());
  std::error_code error;
  fs::create_directories(target_.parent_path(), error);
  if (error) fail(target_.parent_path(), error, "choose a folder that you may write to");
  staging_ = target_;
  staging_ += ".partial";
  if (fs::exists(fs::symlink_status(staging_))) staging_ = free_name(staging_);
  if (!fs::create_directory(staging_, error) || error) fail(staging_, error, "choose a folder that you may write to");
  try {
    AtomicFile trial(staging_ / "writable");
    trial.write(std::string_view("yes\n"));
    trial.commit();
  } catch (...) {
    fs::remove_all(staging_, error);
    throw;
  }
  fs::remove(staging_ / "writable", error);
}

OutputFolder::~OutputFolder() {
  std::error_code ignored;
  if (committed_ || (!kept_if_.empty() && fs::exists(kept_if_, ignored))) return;
  fs::remove_all(staging_, ignored);
}

fs::path OutputFolder::commit() {
  std::error_code error;
  fs::path kept;
  if (holds_something(target_)) {
    kept = free_name(target_);
    fs::rename(target_, kept, error);
    if (error) fail(target_, error, "rename the old results by hand and run again");
  }
  fs::rename(staging_, target_, error);
  if (error) {
    std::error_code ignored;
    if (!kept.empty()) fs::rename(kept, target_, ignored);
    fail(target_, error, "check the folder's rights and run again");
  }
  committed_ = true;
  return kept;
}

}  // namespace chainslam::mapper
