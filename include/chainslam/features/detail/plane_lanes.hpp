#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <limits>
#include <numbers>
#include <vector>

#include "chainslam/core/types.hpp"

#if defined(__SSE2__)
#include <emmintrin.h>
#endif

namespace chainslam::detail {

inline constexpr int plane_lanes = 8;
/// Eight numbers, in what registers there are.
typedef double Doubles __attribute__((vector_size(8 * sizeof(double))));

inline void take_square_root(Doubles& v) {
#if defined(__SSE2__)
  for (int i = 0; i < plane_lanes; i += 2) {
    const __m128d root = _mm_sqrt_pd(_mm_setr_pd(v[i], v[i + 1]));
    v[i] = _mm_cvtsd_f64(root);
    v[i + 1] = _mm_cvtsd_f64(_mm_unpackhi_pd(root, root));
  }
#else
  for (int i = 0; i < plane_lanes; ++i) v[i] = std::sqrt(v[i]);
#endif
}

/// Eight symmetric 3x3 matrices.
struct SymmetricLanes {
  Doubles xx, xy, xz, yy, yz, zz;
};

/// Of eight symmetric matrices the eigenvalues, ascending, and a unit eigenvector of the smallest.
struct LeastEigenLanes {
  std::array<Doubles, 3> values;
  std::array<Doubles, 3> vector;
};

/// `symmetric_eigen` (see there) for eight matrices at a time, without branches. Equal eigenvalues give the x axis.
inline void least_eigenvectors(const SymmetricLanes& matrix, LeastEigenLanes& eigen) {
  const auto larger = [](const Doubles& a, Doubles& most) {
    const Doubles magnitude = a < 0.0 ? -a : a;
    most = magnitude > most ? magnitude : most;
  };
  Doubles scale = 4 * std::numeric_limits<double>::min() + Doubles{};
  for (const Doubles* entry : {&matrix.xx, &matrix.xy, &matrix.xz, &matrix.yy, &matrix.yz, &matrix.zz})
    larger(*entry, scale);
  const Doubles inverse_scale = 1.0 / scale;
  const Doubles d = matrix.xy * inverse_scale, e = matrix.xz * inverse_scale, f = matrix.yz * inverse_scale;
  const Doubles mean = (matrix.xx + matrix.yy + matrix.zz) * inverse_scale * (1.0 / 3.0);
  const Doubles a = matrix.xx * inverse_scale - mean, b = matrix.yy * inverse_scale - mean;
  const Doubles c = matrix.zz * inverse_scale - mean;
  Doubles p = (a * a + b * b + c * c + 2.0 * (d * d + e * e + f * f)) * (1.0 / 6.0);
  take_square_root(p);
  const auto isotropic = p <= 1e-16;
  p = isotropic ? 1.0 + Doubles{} : p;

  // The isolated eigenvalue, p times the outermost root of x^3 - 3 x = det: a polynomial, and Newton's method twice.
  const Doubles half_det = 0.5 * (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)) / (p * p * p);
  const auto negative = half_det < 0.0;
  Doubles h = negative ? -half_det : half_det;
  h = h > 1.0 ? 1.0 + Doubles{} : h;
  Doubles x = std::numbers::sqrt3 + h * (1.0 / 3.0 + h * (-0.0935 + h * (0.03658 - 0.00846 * h)));
  for (int step = 0; step < 2; ++step) x = (2.0 * x * x * x + 2.0 * h) / (3.0 * x * x - 3.0);
  const Doubles isolated = negative ? -p * x : p * x;

  // Its eigenvector v: the longest cross product of two rows of what it leaves singular.
  const Doubles r = a - isolated, s = b - isolated, t = c - isolated;
  Doubles vx = d * f - e * s, vy = e * d - r * f, vz = r * s - d * d;
  Doubles length = vx * vx + vy * vy + vz * vz;
  const auto take_longer = [&](const Doubles& ox, const Doubles& oy, const Doubles& oz) {
    const Doubles other = ox * ox + oy * oy + oz * oz;
    const auto longer = other > length;
    vx = longer ? ox : vx;
    vy = longer ? oy : vy;
    vz = longer ? oz : vz;
    length = longer ? other : length;
  };
  take_longer(s * t - f * f, f * e - d * t, d * f - s * e);
  take_longer(f * e - t * d, t * r - e * e, e * d - f * r);
  take_square_root(length);
  const auto lost = !(length > 0.0);
  const Doubles inverse_length = 1.0 / (lost ? 1.0 + Doubles{} : length);
  vx = lost ? 1.0 + Doubles{} : vx * inverse_length;
  vy *= inverse_length;
  vz *= inverse_length;

  // u and w span the plane across v.
  const Doubles vxx = vx * vx, vzz = vz * vz;
  const auto flat = vxx > vzz;
  Doubles ux = flat ? -vy : Doubles{}, uy = flat ? vx : -vz, uz = flat ? Doubles{} : vy;
  Doubles u_length = ux * ux + uy * uy + uz * uz;
  take_square_root(u_length);
  const Doubles inverse_u = 1.0 / u_length;
  ux *= inverse_u;
  uy *= inverse_u;
  uz *= inverse_u;
  const Doubles wx = vy * uz - vz * uy, wy = vz * ux - vx * uz, wz = vx * uy - vy * ux;

  // The 2x2 matrix [low_side turn; turn high_side] of the map in (u, w), made diagonal by one rotation of tangent k.
  const Doubles mux = a * ux + d * uy + e * uz, muy = d * ux + b * uy + f * uz, muz = e * ux + f * uy + c * uz;
  const Doubles mwx = a * wx + d * wy + e * wz, mwy = d * wx + b * wy + f * wz, mwz = e * wx + f * wy + c * wz;
  const Doubles low_side = ux * mux + uy * muy + uz * muz, high_side = wx * mwx + wy * mwy + wz * mwz;
  const Doubles turn = ux * mwx + uy * mwy + uz * mwz;
  const Doubles difference = high_side - low_side;
  Doubles root = difference * difference + 4.0 * turn * turn;
  take_square_root(root);
  const Doubles divisor = difference < 0.0 ? difference - root : difference + root;
  const Doubles k = root > 0.0 ? 2.0 * turn / (root > 0.0 ? divisor : 1.0 + Doubles{}) : Doubles{};
  Doubles cosine = 1.0 + k * k;
  take_square_root(cosine);
  cosine = 1.0 / cosine;
  const Doubles sine = k * cosine;
  const Doubles first = low_side - k * turn, second = high_side + k * turn;
  const auto swapped = first > second;
  const Doubles low = swapped ? second : first, high = swapped ? first : second;
  const Doubles minor_u = swapped ? sine : cosine, minor_w = swapped ? cosine : -sine;

  const Doubles mvx = a * vx + d * vy + e * vz, mvy = d * vx + b * vy + f * vz, mvz = e * vx + f * vy + c * vz;
  const Doubles alone = vx * mvx + vy * mvy + vz * mvz;
  const Doubles nx = negative ? vx : minor_u * ux + minor_w * wx;
  const Doubles ny = negative ? vy : minor_u * uy + minor_w * wy;
  const Doubles nz = negative ? vz : minor_u * uz + minor_w * wz;
  eigen.vector[0] = isotropic ? 1.0 + Doubles{} : nx;
  eigen.vector[1] = isotropic ? Doubles{} : ny;
  eigen.vector[2] = isotropic ? Doubles{} : nz;
  eigen.values[0] = (isotropic ? mean : mean + (negative ? alone : low)) * scale;
  eigen.values[1] = (isotropic ? mean : mean + (negative ? low : high)) * scale;
  eigen.values[2] = (isotropic ? mean : mean + (negative ? high : alone)) * scale;
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
