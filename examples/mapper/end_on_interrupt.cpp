#include "end_on_interrupt.hpp"

#include <unistd.h>

#include <cstdio>
#include <string>
#include <system_error>
#include <utility>

#include "chainslam/io/detail/partial_file.hpp"
#include "exit_code.hpp"
#include "output.hpp"

namespace chainslam::mapper {

namespace fs = std::filesystem;

namespace {

/// Deletes the folder of results that was begun. It gets another name first: nothing can be written to it then.
void delete_begun_folder(const fs::path& folder) {
  fs::path renamed = folder;
  renamed += "-" + std::to_string(::getpid()) + "-interrupted";
  std::error_code error;
  fs::rename(folder, renamed, error);
  fs::remove_all(error ? folder : renamed, error);
}

/// Deletes what this process, and no other, is writing for a result: the temporaries have its number in their names, a
/// map's partial file has its lock.
void delete_begun(const fs::path& result) {
  const std::string process = std::to_string(::getpid());
  const std::string name = result.filename().string() + ".partial";
  std::error_code error;
  const fs::path folder = result.has_parent_path() ? result.parent_path() : fs::path(".");
  for (fs::directory_iterator entry(folder, error), end; !error && entry != end; entry.increment(error)) {
    const std::string found = entry->path().filename().string();
    // A result may be several files, such as a cloud for each frame: its name then is not the whole of theirs.
    const bool mine =
        found.find(".partial-" + process + "-") != std::string::npos ||
        (found == name && entry->is_regular_file(error) && detail::lock_holder(entry->path()) == "process " + process);
    std::error_code ignored;
    if (mine) fs::remove(entry->path(), ignored);
  }
}

}  // namespace

EndOnInterrupt::EndOnInterrupt(fs::path result, const char* message)
    : interrupt_(message), end_(interrupt_.token(), End{std::move(result)}) {}

/// On the thread that watches for signals, while the verb's own goes on: nothing of it is touched, and none of its
/// destructors run.
void EndOnInterrupt::End::operator()() const {
  const BegunFolder folder = begun_folder();
  if (!folder.path.empty()) delete_begun_folder(folder.path);
  if (!result.empty()) delete_begun(result);
  ::_exit(exit_interrupted);
}

}  // namespace chainslam::mapper
