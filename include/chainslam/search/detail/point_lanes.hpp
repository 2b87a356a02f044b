#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <limits>

#include "chainslam/core/types.hpp"
#include "chainslam/search/detail/intrinsics.hpp"
#include "chainslam/search/detail/nearest_list.hpp"

namespace chainslam::detail {

/// `Count` points in columns, so that the compiler works on several at a time. Lanes not in use are infinitely far.
template <class Scalar, int Count, int Dim = 3>
struct alignas(32) Lanes {
  using Vector = Eigen::Matrix<Scalar, Dim, 1>;
  using Column = std::array<Scalar, static_cast<std::size_t>(Count)>;
  static constexpr Scalar far = std::numeric_limits<Scalar>::infinity();

  std::array<Column, static_cast<std::size_t>(Dim)> columns = filled();

  static constexpr auto filled() {
    std::array<Column, static_cast<std::size_t>(Dim)> values{};
    for (Column& column : values) column.fill(far);
    return values;
  }

  void set(int lane, const Scalar* p) {
    for (int axis = 0; axis < Dim; ++axis) at(axis, lane) = p[axis];
  }
  void set(int lane, const Vector& p) { set(lane, p.data()); }
  void clear(int lane) {
    for (int axis = 0; axis < Dim; ++axis) at(axis, lane) = far;
  }

  /// Whether the very same point lies there.
  [[nodiscard]] bool holds(int lane, const Vector& p) const {
    const Vector here = position(lane);
    bool same = true;
    for (int axis = 0; axis < Dim; ++axis) same = same && here[axis] == p[axis];
    return same;
  }
  [[nodiscard]] Vector position(int lane) const {
    Vector p;
    for (int axis = 0; axis < Dim; ++axis)
      p[axis] = columns[static_cast<std::size_t>(axis)][static_cast<std::size_t>(lane)];
    return p;
  }

 private:
  [[nodiscard]] Scalar& at(int axis, int lane) {
    return columns[static_cast<std::size_t>(axis)][static_cast<std::size_t>(lane)];
  }
};

/// Bit i is set where values[i] < bound; values are 32-byte aligned.
template <class Scalar, std::size_t Count>
[[nodiscard]] std::uint32_t lanes_below(const std::array<Scalar, Count>& values, Scalar bound) {
  static_assert(Count <= 32 && Count % 4 == 0);
  std::uint32_t mask = 0;
  if constexpr (sizeof(Scalar) == 4) {
#if defined(__AVX__)
    if constexpr (Count % 8 == 0) {
      for (std::size_t i = 0; i < Count; i += 8) {
        const __m256 below = _mm256_cmp_ps(_mm256_load_ps(&values[i]), _mm256_set1_ps(bound), _CMP_LT_OQ);
        mask |= static_cast<std::uint32_t>(_mm256_movemask_ps(below)) << i;
      }
      return mask;
    }
#endif
#if defined(__SSE2__)
    for (std::size_t i = 0; i < Count; i += 4) {
      const __m128 below = _mm_cmplt_ps(_mm_load_ps(&values[i]), _mm_set1_ps(bound));
      mask |= static_cast<std::uint32_t>(_mm_movemask_ps(below)) << i;
    }
    return mask;
#elif defined(__aarch64__) && defined(__ARM_NEON)
    const uint32x4_t bits{1, 2, 4, 8};
    for (std::size_t i = 0; i < Count; i += 4) {
      const uint32x4_t below = vcltq_f32(vld1q_f32(&values[i]), vdupq_n_f32(bound));
      mask |= vaddvq_u32(vandq_u32(below, bits)) << i;
    }
    return mask;
#endif
  }
  for (std::size_t i = 0; i < Count; ++i) mask |= static_cast<std::uint32_t>(values[i] < bound) << i;
  return mask;
}

/// Squared distances of all lanes to a query.
template <class Scalar, int Count, int Dim>
void squared_distances(const Lanes<Scalar, Count, Dim>& lanes, const Scalar* query,
                       std::array<Scalar, static_cast<std::size_t>(Count)>& distances) {
  for (std::size_t i = 0; i < Count; ++i) {
    const Scalar dx = lanes.columns[0][i] - query[0];
    const Scalar dy = lanes.columns[1][i] - query[1];
    if constexpr (Dim == 3) {
      const Scalar dz = lanes.columns[2][i] - query[2];
      distances[i] = dx * dx + dy * dy + dz * dz;
    } else {
      distances[i] = dx * dx + dy * dy;
    }
  }
}

/// A distance within which there are k <= 8 points or more, and not many more: each eighth lane's nearest, or for one
/// point the nearest of all.
template <class Scalar, std::size_t Count>
[[nodiscard]] Scalar enough_for(std::size_t k, const std::array<Scalar, Count>& distances) {
  std::array<Scalar, 8> nearest;
  for (std::size_t i = 0; i < 8; ++i) nearest[i] = distances[i];
  for (std::size_t i = 8; i < Count; i += 8)
    for (std::size_t j = 0; j < 8; ++j) nearest[j] = nearest[j] < distances[i + j] ? nearest[j] : distances[i + j];
  const auto [least, most] = std::minmax_element(nearest.begin(), nearest.end());
  return k == 1 ? *least : *most;
}

/// Offers every point of `lanes` nearer than the collector's bound; `index_of(lane)` names it.
template <class Scalar, int Count, int Dim, class Collector, class IndexOf>
void scan(const Lanes<Scalar, Count, Dim>& lanes, const Scalar* query, Collector& found, IndexOf&& index_of) {
  alignas(64) std::array<Scalar, static_cast<std::size_t>(Count)> distances;
  squared_distances(lanes, query, distances);
  std::uint32_t near = lanes_below(distances, found.bound());
  if constexpr (KeepsFew<Collector> && Count > 8) {
    // The first leaf of a search: most of its points would be put in the list to be put out again.
    if (std::popcount(near) > (found.k() == 1 ? 2 : 12))
      if (const Scalar enough = enough_for(found.k(), distances); enough < found.bound())
        near = lanes_below(distances, next_above(enough));
  }
  for (; near != 0; near &= near - 1) {
    const int lane = std::countr_zero(near);
    const Scalar distance = distances[static_cast<std::size_t>(lane)];
    if (refuses_cheaply<Collector> || distance < found.bound())  // which may have come nearer
      found.offer(index_of(lane), distance);
  }
}

}  // namespace chainslam::detail
