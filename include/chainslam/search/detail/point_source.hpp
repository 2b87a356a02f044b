#pragma once

#include <Eigen/Core>
#include <concepts>
#include <cstddef>
#include <ranges>
#include <type_traits>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam::detail {

/// A contiguous range of vectors of Dim coordinates, such as `std::vector<Eigen::Vector2f>`.
template <class T, int Dim>
concept VectorRange = std::ranges::contiguous_range<T> && std::ranges::sized_range<T> &&
    (std::same_as<std::remove_cv_t<std::ranges::range_value_t<T>>, Eigen::Matrix<float, Dim, 1>> ||
     std::same_as<std::remove_cv_t<std::ranges::range_value_t<T>>, Eigen::Matrix<double, Dim, 1>>);

/// What a search structure over Dim dimensions is filled from: any cloud in three, a range of vectors in two.
template <class T, int Dim>
concept PointSource = VectorRange<T, Dim> ||(Dim == 3 && Cloud<T>);

template <int Dim, PointSource<Dim> Points>
[[nodiscard]] Index source_size(const Points& points) {
  if constexpr (VectorRange<Points, Dim>)
    return to_index(std::ranges::size(points), "points");
  else
    return to_index(cloud_size(points), "cloud");
}

/// Point i, rounded to Scalar.
template <class Scalar, int Dim, PointSource<Dim> Points>
[[nodiscard]] Eigen::Matrix<Scalar, Dim, 1> source_position(const Points& points, Index i) {
  const auto place = static_cast<std::size_t>(i);
  if constexpr (VectorRange<Points, Dim>)
    return std::ranges::data(points)[place].template cast<Scalar>();
  else
    return chainslam::position(points, place).template cast<Scalar>();
}

}  // namespace chainslam::detail
