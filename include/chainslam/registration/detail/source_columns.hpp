#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <concepts>
#include <cstddef>
#include <type_traits>
#include <vector>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/registration/concepts.hpp"
#include "chainslam/registration/detail/quad.hpp"
#include "chainslam/registration/metrics.hpp"

namespace chainslam::detail {

/// `Rows` columns of `count` numbers, padded so that whole quads can be read.
template <class Number, int Rows>
class Columns {
 public:
  Columns() = default;
  explicit Columns(Index count, Number value = 0)
      : stride_((static_cast<std::size_t>(count) + Quad::size - 1) / Quad::size * Quad::size),
        numbers_(stride_ * static_cast<std::size_t>(Rows), value) {}

  [[nodiscard]] bool empty() const { return numbers_.empty(); }
  [[nodiscard]] Number* at(int row, Index i) { return numbers_.data() + place(row, i); }
  [[nodiscard]] const Number* at(int row, Index i) const { return numbers_.data() + place(row, i); }

  template <std::size_t N>
    requires(N == static_cast<std::size_t>(Rows))
  void set(Index i, const std::array<Number, N>& values) {
    for (int row = 0; row < Rows; ++row) *at(row, i) = values[static_cast<std::size_t>(row)];
  }

 private:
  [[nodiscard]] std::size_t place(int row, Index i) const {
    return static_cast<std::size_t>(row) * stride_ + static_cast<std::size_t>(i);
  }

  std::size_t stride_ = 0;
  std::vector<Number> numbers_;
};

/// Numbers that describe a surface.
[[nodiscard]] constexpr int numbers_of(Surface surface) {
  return surface == Surface::normal ? 3 : surface == Surface::covariance ? 6 : 0;
}

/// A normal in float, zero if it is not finite.
template <class Vector>
[[nodiscard]] std::array<float, 3> finite_normal(const Vector& n) {
  const std::array<float, 3> normal{static_cast<float>(n[0]), static_cast<float>(n[1]), static_cast<float>(n[2])};
  return is_finite(normal[0]) && is_finite(normal[1]) && is_finite(normal[2]) ? normal : std::array<float, 3>{};
}

/// The upper triangle: xx, xy, xz, yy, yz, zz.
template <class Matrix>
[[nodiscard]] std::array<float, 6> upper_triangle(const Matrix& m) {
  return {static_cast<float>(m(0, 0)), static_cast<float>(m(0, 1)), static_cast<float>(m(0, 2)),
          static_cast<float>(m(1, 1)), static_cast<float>(m(1, 2)), static_cast<float>(m(2, 2))};
}

/// The disc I - (1 - thickness) n n'.
[[nodiscard]] inline std::array<float, 6> disc(const std::array<float, 3>& n, double thickness) {
  const auto k = static_cast<float>(1.0 - thickness);
  return {1 - k * n[0] * n[0], -k * n[0] * n[1], -k * n[0] * n[2],
          1 - k * n[1] * n[1], -k * n[1] * n[2], 1 - k * n[2] * n[2]};
}

/// The finite points of a source about a pivot, in columns, with their surfaces in the source's axes.
struct SourceColumns {
  Eigen::Vector3d pivot = Eigen::Vector3d::Zero();
  Index count = 0;
  Columns<double, 3> positions;
  Columns<float, 3> normals;
  Columns<float, 6> covariances;
};

/// Which columns a metric and a rejector want.
struct SourceWants {
  bool normals = false;
  bool covariances = false;
  double thickness = 1e-3;     ///< of discs where covariances are to be made from normals
  bool about_centroid = true;  ///< else about the source's origin
};

/// One point of every `stride`, about the same pivot; each time another one of the stride, lest a scanner's beams,
/// which follow one another in turn, be told apart.
[[nodiscard]] inline SourceColumns one_of_each(const SourceColumns& source, Index stride) {
  SourceColumns columns;
  columns.pivot = source.pivot;
  columns.count = source.count / stride;
  const auto take = [&](const auto& from, auto& to, int rows) {
    to = std::remove_cvref_t<decltype(to)>(columns.count);
    for (int row = 0; row < rows; ++row)
      for (Index i = 0; i < columns.count; ++i) *to.at(row, i) = *from.at(row, i * stride + i % stride);
  };
  take(source.positions, columns.positions, 3);
  if (!source.normals.empty()) take(source.normals, columns.normals, 3);
  if (!source.covariances.empty()) take(source.covariances, columns.covariances, 6);
  return columns;
}

template <Cloud Source>
[[nodiscard]] SourceColumns source_columns(const Source& source, const SourceWants& wants) {
  const std::size_t size = cloud_size(source);
  Table<Offset> finite;
  finite.reserve(static_cast<Offset>(size));
  SourceColumns columns;
  for (std::size_t i = 0; i < size; ++i) {
    const Eigen::Vector3d p = position(source, i);
    if (!is_finite(p)) continue;
    finite.push_back(static_cast<Offset>(i));
    columns.pivot += p;
  }
  columns.count = to_index(finite.size(), "cloud");
  columns.pivot =
      scaled(wants.about_centroid ? 1.0 / std::max(1.0, static_cast<double>(columns.count)) : 0.0, columns.pivot);
  columns.positions = Columns<double, 3>(columns.count);
  if (wants.normals) columns.normals = Columns<float, 3>(columns.count);
  if (wants.covariances) columns.covariances = Columns<float, 6>(columns.count);
  for (Index i = 0; i < columns.count; ++i) {
    const auto from = static_cast<std::size_t>(finite[i]);
    const Eigen::Vector3d p = position(source, from);
    const Eigen::Vector3d& pivot = columns.pivot;
    columns.positions.set(i, std::array<double, 3>{p[0] - pivot[0], p[1] - pivot[1], p[2] - pivot[2]});
    if constexpr (OrientedCloud<Source>)
      if (wants.normals) columns.normals.set(i, finite_normal(normal(source, from)));
    if (!wants.covariances) continue;
    if constexpr (DistributedCloud<Source>)
      columns.covariances.set(i, upper_triangle(CloudTraits<Source>::covariance(source, from)));
    else if constexpr (OrientedCloud<Source>)
      columns.covariances.set(i, disc(finite_normal(normal(source, from)), wants.thickness));
  }
  return columns;
}

}  // namespace chainslam::detail
