#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstring>
#include <vector>

#include "chainslam/core/lanes.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam::detail {

inline constexpr int plane_lanes = 8;
/// Eight numbers, in what registers there are.
typedef double Doubles __attribute__((vector_size(plane_lanes * sizeof(double))));

using SymmetricLanes = SymmetricMatrices<Doubles>;
using LeastEigenLanes = LeastEigen<Doubles>;

/// Eigenvalues and the smallest's eigenvectors in all lanes.
inline void least_eigenvectors(const SymmetricLanes& matrices, LeastEigenLanes& eigen) {
  for (int first = 0; first < plane_lanes; first += register_lanes) {
    const auto some = [first](const Doubles& all) {
      RegisterDoubles lanes;
      std::memcpy(&lanes, reinterpret_cast<const double*>(&all) + first, sizeof(lanes));
      return lanes;
    };
    const auto put = [first](const RegisterDoubles& lanes, Doubles& all) {
      std::memcpy(reinterpret_cast<double*>(&all) + first, &lanes, sizeof(lanes));
    };
    LeastEigen<RegisterDoubles> found;
    const SymmetricMatrices<RegisterDoubles> few{some(matrices.xx), some(matrices.xy), some(matrices.xz),
                                                 some(matrices.yy), some(matrices.yz), some(matrices.zz)};
    eigenvectors(few, found);
    for (std::size_t i = 0; i < 3; ++i) {
      put(found.values[i], eigen.values[i]);
      put(found.vector[i], eigen.vector[i]);
    }
  }
}

/// Eight neighbourhoods, whose planes are fitted at a time: how neighbours lie about their point.
template <class Scalar>
class PlaneLanes {
 public:
  [[nodiscard]] bool full() const { return used_ == plane_lanes; }
  [[nodiscard]] int used() const { return used_; }
  [[nodiscard]] Index point(int lane) const { return points_[static_cast<std::size_t>(lane)]; }
  [[nodiscard]] Index count(int lane) const { return static_cast<Index>(counts_[static_cast<std::size_t>(lane)]); }

  /// Adds a neighbourhood of `count` points; `offset(i, axis)` says where the i-th lies.
  template <class Offset>
  void add(Index point, std::size_t count, Offset&& offset) {
    const auto lane = static_cast<std::size_t>(used_++);
    points_[lane] = point;
    counts_[lane] = static_cast<double>(count);
    if (rows_ < count) {
      if (offsets_.size() < 3 * plane_lanes * count) offsets_.resize(3 * plane_lanes * count);
      // The other lanes are padded by the point itself, which adds nothing to sums.
      std::fill_n(offsets_.begin() + static_cast<std::ptrdiff_t>(3 * plane_lanes * rows_),
                  3 * plane_lanes * (count - rows_), Scalar(0));
      rows_ = count;
    }
    Scalar* at = offsets_.data() + lane;
    for (std::size_t i = 0; i < count; ++i, at += 3 * plane_lanes)
      for (std::size_t axis = 0; axis < 3; ++axis) at[axis * plane_lanes] = offset(i, axis);
  }

  void clear() { rows_ = 0, used_ = 0; }

  /// Covariances (sums over n, divided by n, m^2) about the means.
  void covariances(SymmetricLanes& out) const {
    typedef Scalar Row __attribute__((vector_size(plane_lanes * sizeof(Scalar))));
    Doubles x{}, y{}, z{}, xx{}, xy{}, xz{}, yy{}, yz{}, zz{};
    const Scalar* at = offsets_.data();
    for (std::size_t i = 0; i < rows_; ++i, at += 3 * plane_lanes) {
      Row row_x, row_y, row_z;
      std::memcpy(&row_x, at, sizeof(Row));
      std::memcpy(&row_y, at + plane_lanes, sizeof(Row));
      std::memcpy(&row_z, at + 2 * plane_lanes, sizeof(Row));
      const Doubles dx = __builtin_convertvector(row_x, Doubles), dy = __builtin_convertvector(row_y, Doubles);
      const Doubles dz = __builtin_convertvector(row_z, Doubles);
      x += dx;
      y += dy;
      z += dz;
      xx += dx * dx;
      xy += dx * dy;
      xz += dx * dz;
      yy += dy * dy;
      yz += dy * dz;
      zz += dz * dz;
    }
    Doubles n;
    for (int lane = 0; lane < plane_lanes; ++lane) n[lane] = std::max(counts_[static_cast<std::size_t>(lane)], 1.0);
    const Doubles share = 1.0 / n;
    x *= share;
    y *= share;
    z *= share;
    out = {xx * share - x * x, xy * share - x * y, xz * share - x * z,
           yy * share - y * y, yz * share - y * z, zz * share - z * z};
  }

 private:
  int used_ = 0;
  std::size_t rows_ = 0;
  std::array<Index, plane_lanes> points_{};
  std::array<double, plane_lanes> counts_{};
  std::vector<Scalar> offsets_;  ///< neighbour by neighbour, axis by axis, lane by lane
};

}  // namespace chainslam::detail
