#pragma once

#include <cstdio>
#include <exception>
#include <filesystem>
#include <string>

#include "chainslam/io/atomic_file.hpp"

namespace chainslam::bench {

/// Makes a table and writes it, whole or not at all. @returns the program's exit code: 3 if either failed, with the
/// reason on the standard error output.
template <class Make>
[[nodiscard]] int write_table(const char* program, const std::filesystem::path& out, const Make& make) {
  try {
    const std::string text = make();
    AtomicFile file(out);
    file.write(text);
    file.commit();
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s: %s\n", program, error.what());
    return 3;
  }
}

}  // namespace chainslam::bench
