#pragma once

#include <Eigen/Core>
#include <concepts>
#include <cstddef>
#include <iterator>
#include <type_traits>
#include <vector>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam::detail {

/// A contiguous range of vectors of Dim coordinates, such as `std::vector<Eigen::Vector2f>`.
template <class T, int Dim>
concept VectorRange = SequenceOf<T, Eigen::Matrix<float, Dim, 1>> || SequenceOf<T, Eigen::Matrix<double, Dim, 1>>;

/// In three dimensions the source itself must be a cloud; in two, a range of vectors stands for one.
template <class T, int Dim>
using CloudInPlace =
    std::conditional_t<Dim == 3, T, std::conditional_t<VectorRange<T, Dim>, std::vector<Eigen::Vector3f>, void>>;

/// What a search structure over Dim dimensions is filled from: any cloud in three, a range of vectors in two. One
/// requirement, not a choice of two, so that a compiler tells what a user's cloud lacks.
template <class T, int Dim>
concept PointSource = Cloud<CloudInPlace<T, Dim>>;

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
  Eigen::Matrix<Scalar, Dim, 1> rounded;
  const auto round = [&](const auto& p) {
    for (int axis = 0; axis < Dim; ++axis) rounded[axis] = static_cast<Scalar>(p[axis]);
  };
  if constexpr (VectorRange<Points, Dim>)
    round(std::ranges::data(points)[place]);
  else
    round(CloudTraits<Points>::position(points, place));
  return rounded;
}

}  // namespace chainslam::detail
