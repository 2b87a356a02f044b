#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

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

/// The same for a data set of several files: the input is cut at zero bytes, a file for each name; the last one gets
/// all that is left, and names left over get empty files. `read` takes the folder.
template <class Read>
int fuzz_folder(const std::uint8_t* data, std::size_t size, const std::vector<std::string>& names, const Read& read) {
  static const TemporaryFolder folder;
  static std::map<std::string, std::optional<std::string>> written;
  std::string_view rest(reinterpret_cast<const char*>(data), size);
  for (const std::string& name : names) {
    const std::size_t end = &name == &names.back() ? std::string_view::npos : rest.find('\0');
    const std::string_view part = rest.substr(0, end);
    std::optional<std::string>& there = written[name];
    if (there != part) write_bytes(folder / name, there.emplace(part));  // most inputs change one file
    rest = end == std::string_view::npos ? std::string_view() : rest.substr(end + 1);
  }
  try {
    read(folder.path());
  } catch (const IoError&) {
  }
  return 0;
}

/// Reads a data set from its start to its end, its truth as well.
inline void read_all(const std::filesystem::path& path) {
  const auto dataset = datasets::open_dataset(path);
  while (dataset->next()) {
  }
  static_cast<void>(dataset->truth());
}

}  // namespace chainslam::test
