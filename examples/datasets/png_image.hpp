#pragma once

#include <cstdint>
#include <filesystem>
#include <vector>

namespace chainslam::datasets {

/// A grey image, rows from top to bottom. 8-bit images keep their values, 0 to 255.
struct GrayImage {
  int width = 0;
  int height = 0;
  std::vector<std::uint16_t> pixels;

  [[nodiscard]] std::uint16_t at(int row, int column) const {
    return pixels[static_cast<std::size_t>(row) * static_cast<std::size_t>(width) + static_cast<std::size_t>(column)];
  }
};

/// Reads a grey PNG of 8 or 16 bits, no larger than 16384 pixels either way.
/// @throws IoError if it is of another kind or damaged.
[[nodiscard]] GrayImage read_gray_png(const std::filesystem::path& path);

}  // namespace chainslam::datasets
