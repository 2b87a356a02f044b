#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <utility>
#include <vector>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam {

/// A cubic grid about the origin, its points numbered along each axis by 16 bits: coordinate = float(number * step),
/// the product in double. A point of the grid is these floats, bit for bit.
struct PositionGrid {
  static constexpr int most = 32767;  ///< largest number, either way

  double step = 0.01;  ///< metres

  /// The coordinate that a number stands for, metres.
  [[nodiscard]] float coordinate(std::int16_t number) const { return static_cast<float>(number * step); }

  /// The nearest number; nothing if it is beyond `most` or `value` is not finite.
  [[nodiscard]] std::optional<std::int16_t> nearest(double value) const {
    const double number = std::round(value / step);
    if (!is_finite(number) || std::abs(number) > most) return std::nullopt;
    return static_cast<std::int16_t>(number);
  }

  /// The number of a coordinate that lies on the grid; nothing for one beside it, be it by one bit.
  [[nodiscard]] std::optional<std::int16_t> exact(float value) const {
    const std::optional<std::int16_t> number = nearest(static_cast<double>(value));
    if (!number || std::bit_cast<std::uint32_t>(coordinate(*number)) != std::bit_cast<std::uint32_t>(value))
      return std::nullopt;
    return number;
  }
};

/// The finest of the grids that `quantized` uses for `step` (step, 2 step, ... 16 step) that all positions lie on;
/// nothing if there is none.
[[nodiscard]] std::optional<PositionGrid> grid_of(const PointCloud<float>& cloud, double step = 0.01);

/// Rounds positions to whole multiples of `step` about the origin, drops repeated and non-finite ones, and brings them
/// into one canonical order: the same set of points gives bit-identical results, whatever order it came in.
///
/// Only positions are kept. If a coordinate exceeds 32767 steps (327 m at 1 cm), the whole cloud takes twice the step,
/// or four times, up to sixteen times it; points beyond even that (5.2 km) are dropped. The order is Morton's, which
/// map files pack best and a `KdTree` is built from fastest. Idempotent.
/// @param cloud  n points about a near origin (the body frame of a keyframe), metres.
/// @param step   metres.
/// @throws std::invalid_argument if `step` is not positive and finite.
template <Cloud Points>
[[nodiscard]] PointCloud<float> quantized(const Points& cloud, double step = 0.01);

/// The points of `quantized(cloud, step)` in their order, each with the mean intensity of those rounded to it; without
/// intensities if the cloud has none.
template <Cloud Points>
[[nodiscard]] PointCloud<float> quantized_with_intensities(const Points& cloud, double step = 0.01);

namespace detail {

inline constexpr int coarsest_grid = 4;  ///< doublings of the step

/// Bit i of a 16-bit number to bit 3 i.
[[nodiscard]] constexpr std::uint64_t spread_by_three(std::uint64_t v) {
  v = (v | v << 32) & 0x001f'0000'0000'ffff;
  v = (v | v << 16) & 0x001f'0000'ff00'00ff;
  v = (v | v << 8) & 0x100f'00f0'0f00'f00f;
  v = (v | v << 4) & 0x10c3'0c30'c30c'30c3;
  return (v | v << 2) & 0x1249'2492'4924'9249;
}

[[nodiscard]] constexpr std::uint64_t gathered_by_three(std::uint64_t v) {
  v &= 0x1249'2492'4924'9249;
  v = (v | v >> 2) & 0x10c3'0c30'c30c'30c3;
  v = (v | v >> 4) & 0x100f'00f0'0f00'f00f;
  v = (v | v >> 8) & 0x001f'0000'ff00'00ff;
  v = (v | v >> 16) & 0x001f'0000'0000'ffff;
  return (v | v >> 32) & 0xffff;
}

/// Place of a grid point on Morton's curve; negative numbers come first.
[[nodiscard]] constexpr std::uint64_t morton_code(const std::array<std::int16_t, 3>& numbers) {
  std::uint64_t code = 0;
  for (std::size_t axis = 0; axis < 3; ++axis)
    code |= spread_by_three(static_cast<std::uint16_t>(numbers[axis]) ^ 0x8000U) << (2 - axis);
  return code;
}

[[nodiscard]] constexpr std::array<std::int16_t, 3> morton_numbers(std::uint64_t code) {
  std::array<std::int16_t, 3> numbers{};
  for (std::size_t axis = 0; axis < 3; ++axis)
    numbers[axis] = static_cast<std::int16_t>(gathered_by_three(code >> (2 - axis)) ^ 0x8000U);
  return numbers;
}

/// Place of the grid point nearest a position on that curve; nothing if the grid does not reach so far.
[[nodiscard]] inline std::optional<std::uint64_t> morton_code(const PositionGrid& grid, const Eigen::Vector3d& p) {
  const auto x = grid.nearest(p[0]), y = grid.nearest(p[1]), z = grid.nearest(p[2]);
  if (!x || !y || !z) return std::nullopt;
  return morton_code({*x, *y, *z});
}

[[nodiscard]] inline Eigen::Vector3f grid_point(const PositionGrid& grid, std::uint64_t code) {
  const auto numbers = morton_numbers(code);
  return {grid.coordinate(numbers[0]), grid.coordinate(numbers[1]), grid.coordinate(numbers[2])};
}

/// The finest grid whose numbers reach to `farthest`, or the coarsest there is.
[[nodiscard]] inline PositionGrid grid_reaching(double farthest, double step) {
  PositionGrid grid{step};
  for (int doubling = 0; doubling < coarsest_grid && !grid.nearest(farthest); ++doubling) grid.step *= 2;
  return grid;
}

/// The grid that reaches all points of a cloud that any grid can.
template <Cloud Points>
[[nodiscard]] PositionGrid grid_reaching(const Points& cloud, double step) {
  if (!is_finite(step) || !(step > 0)) throw std::invalid_argument("quantized: the step is not positive and finite");
  const double reach = step * PositionGrid::most * (1 << coarsest_grid);
  const auto farthest_of = [&](std::size_t i) {
    const Eigen::Vector3d p = position(cloud, i);
    return is_finite(p) ? std::max({std::abs(p[0]), std::abs(p[1]), std::abs(p[2])}) : 2 * reach;
  };
  double farthest = 0;
  for (std::size_t i = 0; i < cloud_size(cloud); ++i)
    if (const double distance = farthest_of(i); distance <= reach) farthest = std::max(farthest, distance);
  return grid_reaching(farthest, step);
}

}  // namespace detail

inline std::optional<PositionGrid> grid_of(const PointCloud<float>& cloud, double step) {
  PositionGrid grid{step};
  for (int doubling = 0; doubling <= detail::coarsest_grid; ++doubling, grid.step *= 2) {
    const bool on_grid = std::all_of(cloud.positions.begin(), cloud.positions.end(), [&](const Eigen::Vector3f& p) {
      return grid.exact(p[0]) && grid.exact(p[1]) && grid.exact(p[2]);
    });
    if (on_grid) return grid;
  }
  return std::nullopt;
}

template <Cloud Points>
PointCloud<float> quantized(const Points& cloud, double step) {
  const PositionGrid grid = detail::grid_reaching(cloud, step);
  std::vector<std::uint64_t> codes;
  codes.reserve(cloud_size(cloud));
  for (std::size_t i = 0; i < cloud_size(cloud); ++i)
    if (const auto code = detail::morton_code(grid, position(cloud, i))) codes.push_back(*code);
  std::sort(codes.begin(), codes.end());
  codes.erase(std::unique(codes.begin(), codes.end()), codes.end());

  PointCloud<float> result;
  result.positions.reserve(codes.size());
  for (const std::uint64_t code : codes) result.positions.push_back(detail::grid_point(grid, code));
  return result;
}

template <Cloud Points>
PointCloud<float> quantized_with_intensities(const Points& cloud, double step) {
  if (!carries_intensities(cloud)) return quantized(cloud, step);
  const PositionGrid grid = detail::grid_reaching(cloud, step);
  std::vector<std::pair<std::uint64_t, std::size_t>> codes;  // points of one code stay in their order
  codes.reserve(cloud_size(cloud));
  for (std::size_t i = 0; i < cloud_size(cloud); ++i)
    if (const auto code = detail::morton_code(grid, position(cloud, i))) codes.emplace_back(*code, i);
  std::sort(codes.begin(), codes.end());

  PointCloud<float> result;
  for (auto first = codes.begin(); first != codes.end();) {
    const auto last = std::find_if(first, codes.end(), [&](const auto& next) { return next.first != first->first; });
    double sum = 0;
    for (auto i = first; i != last; ++i) sum += static_cast<double>(intensity(cloud, i->second));
    result.positions.push_back(detail::grid_point(grid, first->first));
    result.intensities.push_back(static_cast<float>(sum / static_cast<double>(last - first)));
    first = last;
  }
  return result;
}

}  // namespace chainslam
