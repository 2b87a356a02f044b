#pragma once

#include <cstddef>
#include <span>

#include "chainslam/cloud/columns.hpp"
#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam {

/// The points at `indices`, in that order, with every column the cloud carries; an index may come more than once.
///
/// @param indices  each from 0 to the cloud's size - 1.
template <class Scalar = float, Cloud Points>
[[nodiscard]] PointCloud<Scalar> select(const Points& cloud, std::span<const Index> indices) {
  PointCloud<Scalar> chosen;
  const auto fill = [&](auto& column, auto&& value) {
    column.reserve(indices.size());
    for (const Index i : indices) column.push_back(value(static_cast<std::size_t>(i)));
  };
  fill(chosen.positions, [&](std::size_t i) { return converted<Scalar>(position(cloud, i)); });
  if (carries_normals(cloud)) fill(chosen.normals, [&](std::size_t i) { return converted<Scalar>(normal(cloud, i)); });
  if (carries_times(cloud)) fill(chosen.time_offsets, [&](std::size_t i) { return time_offset(cloud, i); });
  if (carries_intensities(cloud)) fill(chosen.intensities, [&](std::size_t i) { return intensity(cloud, i); });
  return chosen;
}

}  // namespace chainslam
