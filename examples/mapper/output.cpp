#include "output.hpp"

#include <string>
#include <string_view>
#include <system_error>
#include <utility>

#include "chainslam/core/error.hpp"
#include "exit_code.hpp"

namespace chainslam::mapper {

namespace fs = std::filesystem;

namespace {

std::mutex begun_mutex;
fs::path begun;  // the staging folder of this process

void set_begun(const fs::path& folder) {
  const std::lock_guard lock(begun_mutex);
  begun = folder;
}

[[noreturn]] void fail(const fs::path& path, const std::error_code& error, const std::string& remedy) {
  throw_output_error(path.string(), "", error.message(), remedy);
}

bool holds_something(const fs::path& path) {
  std::error_code error;
  if (!detail::is_taken(path)) return false;
  return !fs::is_directory(path, error) || !fs::is_empty(path, error);
}

/// Where a path leads if it is a symbolic link. A trailing slash would make `parent_path` the folder itself.
fs::path resolved(const fs::path& path) {
  fs::path target = fs::absolute(path).lexically_normal();
  if (!target.has_filename()) target = target.parent_path();
  std::error_code error;
  for (int links = 0; links < 32 && fs::is_symlink(target, error); ++links) {
    const fs::path next = fs::read_symlink(target, error);
    target = (target.parent_path() / next).lexically_normal();
    if (!target.has_filename()) target = target.parent_path();
  }
  return target;
}

/// As `fs::create_directory`, again as long as a signal interrupts it.
bool create_folder(const fs::path& folder, std::error_code& error) {
  bool made = fs::create_directory(folder, error);
  while (error == std::errc::interrupted) made = fs::create_directory(folder, error);
  return made;
}

/// Makes the disk keep that a folder is in its parent: what is synced in a folder that a loss of power takes is lost.
void sync_entry(const fs::path& folder) {
  RealFileSystem files;
  const fs::path parent = folder.parent_path();
  if (const int error = detail::uninterrupted([&] { return files.sync_directory(parent); }))
    throw_output_error(folder.string(), "making the disk keep the folder's entry",
                       std::generic_category().message(error), "check the disk, or choose another one");
}

/// Makes a folder and those above it that are not there, and makes the disk keep them.
void make_parents(const fs::path& folder) {
  std::error_code error;
  if (fs::is_directory(folder, error)) return;
  if (folder.has_relative_path()) make_parents(folder.parent_path());
  if (!create_folder(folder, error) && error) fail(folder, error, "choose a folder that you may write to");
  sync_entry(folder);
}

/// Makes `wanted`, or `wanted`~1, ... : a folder that was not there before.
fs::path make_folder(const fs::path& wanted) {
  fs::path folder = detail::is_taken(wanted) ? detail::kept_name(wanted) : wanted;
  std::error_code error;
  while (!create_folder(folder, error)) {
    if (error && error != std::errc::file_exists) fail(folder, error, "choose a folder that you may write to");
    folder = detail::kept_name(wanted);
  }
  return folder;
}

}  // namespace

void require_free(const fs::path& path, bool overwrite) {
  if (!path.empty() && !overwrite && detail::is_taken(path)) detail::throw_taken(path);
}

BegunFolder begun_folder() {
  std::unique_lock lock(begun_mutex);
  return {std::move(lock), begun};
}

int Output::exit_code(int otherwise) const { return failures_ > 0 ? exit_output : otherwise; }

void Output::report(const fs::path& path, const std::exception& error) {
  ++failures_;
  if (dynamic_cast<const IoError*>(&error) != nullptr)
    std::fprintf(stderr, "error: %s\n", printable(error.what(), true).c_str());
  else
    std::fprintf(stderr, "error: %s\n  found: %s\n  do: the other results are whole; run again with more memory\n",
                 printable(path.native()).c_str(), printable(error.what()).c_str());
}

OutputFolder::OutputFolder(fs::path target, bool overwrite) : target_(resolved(target)), overwrite_(overwrite) {
  if (!overwrite && holds_something(target_)) detail::throw_taken(target_);
  make_parents(target_.parent_path());
  std::error_code error;
  staging_ = target_;
  {
    const std::lock_guard lock(begun_mutex);  // whoever ends the program finds the folder as soon as it is there
    staging_ = make_folder(staging_ += ".partial");
    begun = staging_;
  }
  try {
    sync_entry(staging_);
    AtomicFile trial(staging_ / "writable");
    trial.write(std::string_view("yes\n"));
    trial.commit();
  } catch (...) {
    set_begun({});
    fs::remove(staging_ / "writable", error);
    fs::remove(staging_, error);
    throw;
  }
  fs::remove(staging_ / "writable", error);
}

OutputFolder::~OutputFolder() {
  set_begun({});
  if (committed_ || keeps_all_) return;
  std::error_code ignored;
  if (drops_all_) fs::remove_all(staging_, ignored);
  for (const fs::path& file : output_.written()) fs::remove(file, ignored);
  fs::remove(staging_, ignored);  // only if nothing is in it
}

fs::path OutputFolder::commit() {
  keeps_all_ = true;  // whatever happens now, the results are whole
  const std::lock_guard lock(begun_mutex);
  begun.clear();
  RealFileSystem files;
  std::error_code ignored;
  detail::Naming naming{.error = EEXIST};
  if (fs::is_directory(target_, ignored))  // which fits if it is empty
    naming.error = detail::uninterrupted([&] { return files.rename(staging_, target_); });
  if (naming.error != 0) naming = detail::give_name(files, staging_, target_, overwrite_);
  if (naming.error != 0)
    throw_output_error(target_.string(), naming.doing, std::generic_category().message(naming.error),
                       "the results are whole in " + printable(staging_.native()) + ": rename that by hand");
  committed_ = true;
  if (const int error = detail::uninterrupted([&] { return files.sync_directory(target_.parent_path()); }))
    throw_output_error(
        target_.string(), "making the disk keep the folder's entry", std::generic_category().message(error),
        "the results are whole and have their name, but a power cut now could undo that: check the disk");
  return naming.kept;
}

}  // namespace chainslam::mapper
