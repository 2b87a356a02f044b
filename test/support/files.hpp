#pragma once

#include <unistd.h>

#include <array>
#include <atomic>
#include <bit>
#include <cstddef>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <sstream>
#include <string>
#include <string_view>

#include "chainslam/core/error.hpp"

namespace chainslam::test {

/// A fresh folder that goes with its contents.
class TemporaryFolder {
 public:
  TemporaryFolder() {
    static std::atomic<int> serial{0};
    path_ = std::filesystem::temp_directory_path() /
            ("chainslam-test-" + std::to_string(::getpid()) + "-" + std::to_string(serial++));
    std::filesystem::create_directories(path_);
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  ~TemporaryFolder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }

  [[nodiscard]] const std::filesystem::path& path() const { return path_; }
  [[nodiscard]] std::filesystem::path operator/(const std::string& name) const { return path_ / name; }
  [[nodiscard]] std::size_t files() const {
    return static_cast<std::size_t>(
        std::distance(std::filesystem::directory_iterator(path_), std::filesystem::directory_iterator()));
  }

 private:
  std::filesystem::path path_;
};

/// Writes a file, its folder first. Where CHAINSLAM_FIXTURES names a folder, a copy of up to 64 KiB stays there in a
/// folder of the file's extension: what fuzzing starts from.
inline void write_bytes(const std::filesystem::path& path, std::string_view bytes) {
  const auto write = [&](const std::filesystem::path& place) {
    std::filesystem::create_directories(place.parent_path());
    std::ofstream file(place, std::ios::binary);
    file.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  };
  write(path);
  if (const char* fixtures = std::getenv("CHAINSLAM_FIXTURES");
      fixtures != nullptr && path.has_extension() && bytes.size() <= 65536)
    write(std::filesystem::path(fixtures) / path.extension().string().substr(1) /
          std::to_string(std::hash<std::string_view>{}(bytes)));
}

inline std::string read_bytes(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

/// A number's bytes, least significant first.
template <class T>
std::string little(T value) {
  const auto bytes = std::bit_cast<std::array<char, sizeof(T)>>(value);
  std::string text(bytes.begin(), bytes.end());
  return std::endian::native == std::endian::little ? text : std::string(text.rbegin(), text.rend());
}

template <class T>
std::string big(T value) {
  const std::string text = little(value);
  return {text.rbegin(), text.rend()};
}

/// The words of the `IoError` that `action` throws; empty if it throws none.
template <class Action>
std::string io_error(const Action& action) {
  try {
    static_cast<void>(action());
  } catch (const IoError& error) {
    return error.what();
  }
  return {};
}

/// Whether `text` contains `part`.
inline bool says(const std::string& text, std::string_view part) { return text.find(part) != std::string::npos; }

/// A recording's table of frames as earlier versions wrote it: without the last three columns, the delta velocities.
inline std::string without_delta_velocity(const std::string& table) {
  std::string earlier;
  std::istringstream lines(table);
  for (std::string line; std::getline(lines, line);) {
    for (int column = 0; column < 3; ++column) line.erase(line.rfind(','));
    earlier += line + '\n';
  }
  return earlier;
}

}  // namespace chainslam::test
