#pragma once

#include <Eigen/Core>
#include <concepts>
#include <iterator>

#include "chainslam/core/types.hpp"

namespace chainslam {

/// How the library reads a cloud. Specialise it for your own type, right after the type:
///
/// ```cpp
/// template <> struct chainslam::CloudTraits<MyCloud> {
///   static std::size_t size(const MyCloud& cloud);
///   static Eigen::Vector3f position(const MyCloud& cloud, std::size_t i);   // metres; Vector3d is fine too
///   static Eigen::Vector3f normal(const MyCloud& cloud, std::size_t i);     // optional, unit length
///   static float time_offset(const MyCloud& cloud, std::size_t i);          // optional, seconds from the scan's stamp
/// };
/// ```
template <class T>
struct CloudTraits;

/// A contiguous, sized range of `Value`. Asked of its iterator: the header `ranges` takes as long to read as a tenth of
/// Eigen.
template <class Range, class Value>
concept SequenceOf = requires(const Range& range) {
  { std::ranges::begin(range) } -> std::contiguous_iterator;
  { std::ranges::size(range) } -> std::integral;
  requires std::same_as<std::iter_value_t<decltype(std::ranges::data(range))>, Value>;
};

/// Every contiguous range of 3-vectors is a cloud: `std::vector<Eigen::Vector3f>`, `std::span<const Eigen::Vector3d>`,
/// ...
template <class Range>
  requires SequenceOf<Range, Eigen::Vector3f> || SequenceOf<Range, Eigen::Vector3d>
struct CloudTraits<Range> {
  static std::size_t size(const Range& range) { return std::ranges::size(range); }  ///< number of points
  static const auto& position(const Range& range, std::size_t i) { return std::ranges::data(range)[i]; }  ///< point i
};

/// A 3 x n matrix is a cloud of its columns.
template <class Scalar, int Columns, int Options>
struct CloudTraits<Eigen::Matrix<Scalar, 3, Columns, Options>> {
  using Matrix = Eigen::Matrix<Scalar, 3, Columns, Options>;  ///< the cloud
  /// Number of columns.
  static std::size_t size(const Matrix& matrix) { return static_cast<std::size_t>(matrix.cols()); }
  /// Column i.
  static Eigen::Matrix<Scalar, 3, 1> position(const Matrix& matrix, std::size_t i) {
    return matrix.col(static_cast<Eigen::Index>(i));
  }
};

/// A sequence of 3-D points, metres, readable through `CloudTraits` in O(1) per point.
template <class T>
concept Cloud = requires(const T& cloud, std::size_t i) {
  { CloudTraits<T>::size(cloud) } -> std::convertible_to<std::size_t>;
  { CloudTraits<T>::position(cloud, i)[0] } -> std::convertible_to<double>;
  { CloudTraits<T>::position(cloud, i)[2] } -> std::convertible_to<double>;
};

/// A cloud with a unit normal at every point.
template <class T>
concept OrientedCloud = Cloud<T> && requires(const T& cloud, std::size_t i) {
  { CloudTraits<T>::normal(cloud, i)[0] } -> std::convertible_to<double>;
};

/// A cloud that knows when each point was measured, in seconds from the scan's stamp.
template <class T>
concept TimedCloud = Cloud<T> && requires(const T& cloud, std::size_t i) {
  { CloudTraits<T>::time_offset(cloud, i) } -> std::convertible_to<double>;
};

/// Number of points.
template <Cloud T>
[[nodiscard]] std::size_t cloud_size(const T& cloud) {
  return CloudTraits<T>::size(cloud);
}

/// Position i in double, whatever the cloud stores.
template <Cloud T>
[[nodiscard]] Eigen::Vector3d position(const T& cloud, std::size_t i) {
  const auto& p = CloudTraits<T>::position(cloud, i);
  return {static_cast<double>(p[0]), static_cast<double>(p[1]), static_cast<double>(p[2])};
}

/// Position i in float, the search structures' scalar.
template <Cloud T>
[[nodiscard]] Eigen::Vector3f position_f(const T& cloud, std::size_t i) {
  const auto& p = CloudTraits<T>::position(cloud, i);
  return {static_cast<float>(p[0]), static_cast<float>(p[1]), static_cast<float>(p[2])};
}

}  // namespace chainslam
