#pragma once

#include <cerrno>
#include <filesystem>
#include <string>
#include <system_error>

#include "chainslam/core/error.hpp"
#include "chainslam/io/file_system.hpp"

namespace chainslam::detail {

[[nodiscard]] inline bool is_taken(const std::filesystem::path& path) {
  std::error_code error;
  return std::filesystem::exists(std::filesystem::symlink_status(path, error));
}

/// The first of PATH~1, PATH~2, ... that is free.
[[nodiscard]] inline std::filesystem::path kept_name(const std::filesystem::path& path) {
  for (int number = 1;; ++number) {
    std::filesystem::path candidate = path;
    candidate += "~" + std::to_string(number);
    if (!is_taken(candidate)) return candidate;
  }
}

[[noreturn]] inline void throw_taken(const std::filesystem::path& path) {
  throw_output_error(path.string(), "", "something is there already",
                     "choose another name, or pass --overwrite: what is there is then kept as " +
                         printable(kept_name(path).filename().native()));
}

/// What became of giving something its name.
struct Naming {
  int error = 0;                 ///< errno; 0: it has its name
  std::string doing{};           ///< what failed
  std::filesystem::path kept{};  ///< where what had the name is now; empty if nothing had it
};

/// Keeps what has the name `to` under another one. A file has both until it is replaced, so that there is no moment
/// without. Where that cannot be (folders, disks without second names), the first name is free then.
/// @param both  whether it may have both.
template <FileSystem Files>
[[nodiscard]] Naming keep_old(Files& files, const std::filesystem::path& to, bool& both) {
  for (;;) {
    Naming naming{.kept = kept_name(to)};
    naming.doing = "keeping the old one as " + naming.kept.string();
    naming.error = both ? uninterrupted([&] { return files.link(to, naming.kept); }) : EPERM;
    both = naming.error != EPERM && naming.error != ENOTSUP && naming.error != EMLINK && naming.error != ENOSYS &&
           naming.error != EACCES;
    if (!both) naming.error = uninterrupted([&] { return files.rename_new(to, naming.kept); });
    if (naming.error != EEXIST) return naming;  // else another process was faster with the name
  }
}

/// Gives what was finished as `from` the name `to`: the one way in which results get their names. What had the name is
/// kept as TO~1, TO~2, ... if `overwrite` is set; else it stays, and the error is EEXIST. After any failure what had
/// the name still has it.
template <FileSystem Files>
[[nodiscard]] Naming give_name(Files& files, const std::filesystem::path& from, const std::filesystem::path& to,
                               bool overwrite) {
  constexpr const char* naming_it = "giving it its name";
  for (;;) {
    if (!is_taken(to)) {
      const int error = uninterrupted([&] { return files.rename_new(from, to); });
      if (error == EEXIST && overwrite) continue;  // another process was faster
      return {error, naming_it, {}};
    }
    if (!overwrite) return {EEXIST, naming_it, {}};
    std::error_code ignored;
    bool both = !std::filesystem::is_directory(from, ignored);
    Naming naming = keep_old(files, to, both);
    if (naming.error == ENOENT) continue;  // it went by itself
    if (naming.error != 0) return naming;
    naming.doing = naming_it;
    naming.error = uninterrupted([&] { return files.rename(from, to); });
    if (naming.error == 0) return naming;
    if (both)
      files.remove(naming.kept);  // its second name only
    else
      files.rename_new(naming.kept, to);
    return naming;
  }
}

}  // namespace chainslam::detail
