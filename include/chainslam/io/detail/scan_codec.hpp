#pragma once

#include <Eigen/Core>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/cloud/quantize.hpp"
#include "chainslam/core/byte_archive.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/io/detail/byte_reader.hpp"

namespace chainslam::detail {

// A scan as bytes that a codec packs well: columns, of each first all lowest bytes, then all next ones, ... Positions
// on a grid are 16-bit numbers, each the zigzag-coded difference from the one before; other columns are floats.
inline constexpr std::size_t scan_head_bytes = 32;
inline constexpr std::uint32_t scan_of_floats = 0, scan_on_grid = 1;
enum ScanColumns : std::uint32_t { scan_normals = 1, scan_times = 2, scan_intensities = 4, scan_all_columns = 7 };

/// Even with all columns such a scan stays within the largest payload, 2^28 bytes.
inline constexpr std::size_t most_scan_points = ((std::size_t{1} << 28) - scan_head_bytes) / 32;

/// Bytes behind the head.
[[nodiscard]] constexpr std::uint64_t scan_body_bytes(std::uint32_t encoding, std::uint32_t columns,
                                                      std::uint32_t points) {
  std::uint64_t per_point = encoding == scan_on_grid ? 6 : 12;
  if (columns & scan_normals) per_point += 12;
  if (columns & scan_times) per_point += 4;
  if (columns & scan_intensities) per_point += 4;
  return per_point * points;
}

/// Appends `count` numbers byte plane by byte plane; `value(i)` is an unsigned number.
template <class Value>
void append_planes(std::vector<std::byte>& out, std::size_t count, Value&& value) {
  using Number = decltype(value(std::size_t{}));
  const std::size_t start = out.size();
  out.resize(start + count * sizeof(Number));
  for (std::size_t i = 0; i < count; ++i) {
    const Number number = value(i);
    for (std::size_t plane = 0; plane < sizeof(Number); ++plane)
      out[start + plane * count + i] = static_cast<std::byte>((number >> (8 * plane)) & 0xff);
  }
}

/// Number i of `count` stored in planes.
template <class Number>
[[nodiscard]] Number from_planes(std::span<const std::byte> planes, std::size_t count, std::size_t i) {
  Number number = 0;
  for (std::size_t plane = 0; plane < sizeof(Number); ++plane)
    number = static_cast<Number>(number | static_cast<Number>(planes[plane * count + i]) << (8 * plane));
  return number;
}

template <class Value>
void append_floats(std::vector<std::byte>& out, std::size_t count, Value&& value) {
  append_planes(out, count, [&](std::size_t i) { return std::bit_cast<std::uint32_t>(value(i)); });
}

template <class Take>
void read_floats(ByteReader& in, std::size_t count, Take&& take) {
  const auto planes = in.take(count * sizeof(float));
  for (std::size_t i = 0; i < count; ++i) take(i, std::bit_cast<float>(from_planes<std::uint32_t>(planes, count, i)));
}

[[nodiscard]] constexpr std::uint16_t zigzag(std::int16_t from, std::int16_t to) {
  const int difference = static_cast<std::int16_t>(static_cast<std::uint16_t>(to - from));
  return static_cast<std::uint16_t>(difference * 2 ^ difference >> 15);
}
[[nodiscard]] constexpr std::int16_t unzigzag(std::int16_t from, std::uint16_t code) {
  const int difference = (code >> 1) ^ -(code & 1);
  return static_cast<std::int16_t>(static_cast<std::uint16_t>(from + difference));
}

/// Appends a scan. On a grid if all positions lie on one exactly, else as floats: either way nothing is lost.
inline void append_scan(std::vector<std::byte>& out, KeyframeId keyframe, const PointCloud<float>& cloud) {
  constexpr std::array<double, 6> steps = {0.01, 0.001, 0.002, 0.005, 0.025, 0.1};  // metres; doublings come with them
  const std::size_t count = cloud.size();
  std::optional<PositionGrid> grid;
  for (std::size_t i = 0; i < steps.size() && !grid; ++i) grid = grid_of(cloud, steps[i]);
  const std::uint32_t columns = (cloud.has_normals() ? scan_normals : 0U) | (cloud.has_times() ? scan_times : 0U) |
                                (cloud.has_intensities() ? scan_intensities : 0U);
  append_bytes(out, keyframe.value);
  append_bytes(out, grid ? scan_on_grid : scan_of_floats);
  append_bytes(out, static_cast<std::uint32_t>(count));
  append_bytes(out, columns);
  append_bytes(out, grid ? grid->step : 0.0);
  append_bytes(out, std::uint64_t{0});
  for (Eigen::Index axis = 0; axis < 3; ++axis) {
    const auto coordinate = [&](std::size_t i) { return cloud.positions[i][axis]; };
    std::int16_t last = 0;
    if (grid)
      append_planes(out, count, [&](std::size_t i) {
        const std::int16_t number = *grid->nearest(static_cast<double>(coordinate(i)));
        return zigzag(std::exchange(last, number), number);
      });
    else
      append_floats(out, count, coordinate);
  }
  if (columns & scan_normals)
    for (Eigen::Index axis = 0; axis < 3; ++axis)
      append_floats(out, count, [&](std::size_t i) { return cloud.normals[i][axis]; });
  if (columns & scan_times) append_floats(out, count, [&](std::size_t i) { return cloud.time_offsets[i]; });
  if (columns & scan_intensities) append_floats(out, count, [&](std::size_t i) { return cloud.intensities[i]; });
}

/// What a scan's head says.
struct ScanHead {
  KeyframeId keyframe;
  std::uint32_t encoding = 0;
  std::uint32_t points = 0;
  std::uint32_t columns = 0;
  PositionGrid grid;
};

/// @param in  `scan_head_bytes` at least.
[[nodiscard]] inline ScanHead read_scan_head(ByteReader& in) {
  ScanHead head;
  head.keyframe.value = in.take<std::int32_t>();
  head.encoding = in.take<std::uint32_t>();
  head.points = in.take<std::uint32_t>();
  head.columns = in.take<std::uint32_t>();
  head.grid.step = in.take<double>();
  static_cast<void>(in.take<std::uint64_t>());
  return head;
}

/// The points behind a head that has been checked.
/// @param in  exactly `scan_body_bytes`.
[[nodiscard]] inline PointCloud<float> read_scan_body(const ScanHead& head, ByteReader& in) {
  const std::size_t count = head.points;
  PointCloud<float> cloud;
  cloud.positions.resize(count);
  for (Eigen::Index axis = 0; axis < 3; ++axis) {
    if (head.encoding == scan_on_grid) {
      const auto planes = in.take(count * sizeof(std::uint16_t));
      std::int16_t number = 0;
      for (std::size_t i = 0; i < count; ++i) {
        number = unzigzag(number, from_planes<std::uint16_t>(planes, count, i));
        cloud.positions[i][axis] = head.grid.coordinate(number);
      }
    } else {
      read_floats(in, count, [&](std::size_t i, float value) { cloud.positions[i][axis] = value; });
    }
  }
  if (head.columns & scan_normals) {
    cloud.normals.resize(count);
    for (Eigen::Index axis = 0; axis < 3; ++axis)
      read_floats(in, count, [&](std::size_t i, float value) { cloud.normals[i][axis] = value; });
  }
  const auto read_column = [&](std::uint32_t bit, std::vector<float>& column) {
    if (!(head.columns & bit)) return;
    column.resize(count);
    read_floats(in, count, [&](std::size_t i, float value) { column[i] = value; });
  };
  read_column(scan_times, cloud.time_offsets);
  read_column(scan_intensities, cloud.intensities);
  return cloud;
}

}  // namespace chainslam::detail
