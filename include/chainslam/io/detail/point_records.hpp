#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/io/input_file.hpp"

namespace chainslam::detail {

/// Reads a file that holds a scan's points as records of `stride` bytes and nothing else.
///
/// @param layout  says what the file should hold, such as "KITTI's scans hold 16 bytes a point".
/// @param take    called with each record's first byte and the cloud, whose positions and intensities have room.
/// @throws IoError if the file's size is no multiple of `stride` or it cannot be read.
template <class Take>
[[nodiscard]] PointCloud<float> read_point_records(const std::filesystem::path& path, std::size_t stride,
                                                   const std::string& layout, const Take& take) {
  InputFile file(path);
  file.require(0, "points");
  const std::uint64_t size = file.size().value_or(0);
  if (size % stride != 0)
    file.fail("byte " + std::to_string(size - size % stride),
              std::to_string(size % stride) + " bytes after the last point",
              layout + ": the file was cut short or is of another kind");
  const auto count = static_cast<std::size_t>(to_index(size / stride, "points of a scan"));
  PointCloud<float> cloud;
  cloud.positions.reserve(count);
  cloud.intensities.reserve(count);
  constexpr std::size_t block = 1024;  // records that are read together
  std::vector<std::byte> records(std::min(count, block) * stride);
  for (std::size_t done = 0; done < count; done += block) {
    const std::size_t now = std::min(block, count - done);
    file.read(std::span(records).first(now * stride), "points");
    for (std::size_t i = 0; i < now; ++i) take(records.data() + i * stride, cloud);
  }
  return cloud;
}

}  // namespace chainslam::detail
