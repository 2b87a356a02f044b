#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>

#include "chainslam/core/error.hpp"
#include "datasets/dataset.hpp"
#include "support/files.hpp"

namespace chainslam::test {

/// Writes libFuzzer's input to a file of this name, in a folder of the process's own, and has it read. A reader may
/// refuse it with an `IoError`; anything else ends the program, and so finds a fault.
template <class Read>
int fuzz(const std::uint8_t* data, std::size_t size, const std::string& name, const Read& read) {
  static const TemporaryFolder folder;
  const std::filesystem::path path = folder / name;
  write_bytes(path, std::string_view(reinterpret_cast<const char*>(data), size));
  try {
    read(path);
  } catch (const IoError&) {
  }
  return 0;
}

/// Reads a data set from its start to its end.
inline void read_all(const std::filesystem::path& path) {
  const auto dataset = datasets::open_dataset(path);
  while (dataset->next()) {
  }
}

}  // namespace chainslam::test
