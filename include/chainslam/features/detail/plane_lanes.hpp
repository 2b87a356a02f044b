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
#elif defined(__aarch64__) && defined(__ARM_NEON)
#include <arm_neon.h>
#endif

namespace chainslam::detail {

inline constexpr int plane_lanes = 8;
/// Eight numbers, in what registers there are.
typedef double Doubles __attribute__((vector_size(plane_lanes * sizeof(double))));

#if defined(__AVX__)
inline constexpr int register_lanes = 4;
#else
inline constexpr int register_lanes = 2;
#endif
/// As many as one register holds: long formulas on more spill them all.
typedef double RegisterDoubles __attribute__((vector_size(register_lanes * sizeof(double))));

inline void take_square_root(RegisterDoubles& v) {
#if defined(__SSE2__)
  for (int i = 0; i < register_lanes; i += 2) {
    const __m128d root = _mm_sqrt_pd(_mm_setr_pd(v[i], v[i + 1]));
    v[i] = _mm_cvtsd_f64(root);
    v[i + 1] = _mm_cvtsd_f64(_mm_unpackhi_pd(root, root));
  }
#elif defined(__aarch64__) && defined(__ARM_NEON)
  const float64x2_t root = vsqrtq_f64(float64x2_t{v[0], v[1]});
  v = RegisterDoubles{root[0], root[1]};
#else
  for (int i = 0; i < register_lanes; ++i) v[i] = std::sqrt(v[i]);
#endif
}

/// A symmetric 3x3 matrix in each lane.
template <class Numbers>
struct SymmetricMatrices {
  Numbers xx, xy, xz, yy, yz, zz;
};
using SymmetricLanes = SymmetricMatrices<Doubles>;

/// Of symmetric matrices the eigenvalues, ascending, and a unit eigenvector of the smallest.
template <class Numbers>
struct LeastEigen {
  std::array<Numbers, 3> values;
  std::array<Numbers, 3> vector;
};
using LeastEigenLanes = LeastEigen<Doubles>;

/// `symmetric_eigen` (see there) for as many matrices as registers have lanes, without branches. Equal eigenvalues give
/// the x axis.
inline void least_eigenvectors(const SymmetricMatrices<RegisterDoubles>& matrix, LeastEigen<RegisterDoubles>& eigen) {
  const auto larger = [](const RegisterDoubles& a, RegisterDoubles& most) {
    const RegisterDoubles magnitude = a < 0.0 ? -a : a;
    most = magnitude > most ? magnitude : most;
  };
  RegisterDoubles scale = 4 * std::numeric_limits<double>::min() + RegisterDoubles{};
  for (const RegisterDoubles* entry : {&matrix.xx, &matrix.xy, &matrix.xz, &matrix.yy, &matrix.yz, &matrix.zz})
    larger(*entry, scale);
  const RegisterDoubles inverse_scale = 1.0 / scale;
  const RegisterDoubles d = matrix.xy * inverse_scale, e = matrix.xz * inverse_scale, f = matrix.yz * inverse_scale;
  const RegisterDoubles mean = (matrix.xx + matrix.yy + matrix.zz) * inverse_scale * (1.0 / 3.0);
  const RegisterDoubles a = matrix.xx * inverse_scale - mean, b = matrix.yy * inverse_scale - mean;
  const RegisterDoubles c = matrix.zz * inverse_scale - mean;
  RegisterDoubles p = (a * a + b * b + c * c + 2.0 * (d * d + e * e + f * f)) * (1.0 / 6.0);
  take_square_root(p);
  const auto isotropic = p <= 1e-16;
  p = isotropic ? 1.0 + RegisterDoubles{} : p;

  // The isolated eigenvalue, p times the outermost root of x^3 - 3 x = det: a polynomial, and Newton's method twice.
  const RegisterDoubles half_det =
      0.5 * (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)) / (p * p * p);
  const auto negative = half_det < 0.0;
  RegisterDoubles h = negative ? -half_det : half_det;
  h = h > 1.0 ? 1.0 + RegisterDoubles{} : h;
  RegisterDoubles x = std::numbers::sqrt3 + h * (1.0 / 3.0 + h * (-0.0935 + h * (0.03658 - 0.00846 * h)));
  for (int step = 0; step < 2; ++step) x = (2.0 * x * x * x + 2.0 * h) / (3.0 * x * x - 3.0);
  const RegisterDoubles isolated = negative ? -p * x : p * x;

  // Its eigenvector v: the longest cross product of two rows of what it leaves singular.
  const RegisterDoubles r = a - isolated, s = b - isolated, t = c - isolated;
  RegisterDoubles vx = d * f - e * s, vy = e * d - r * f, vz = r * s - d * d;
  RegisterDoubles length = vx * vx + vy * vy + vz * vz;
  const auto take_longer = [&](const RegisterDoubles& ox, const RegisterDoubles& oy, const RegisterDoubles& oz) {
    const RegisterDoubles other = ox * ox + oy * oy + oz * oz;
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
  const RegisterDoubles inverse_length = 1.0 / (lost ? 1.0 + RegisterDoubles{} : length);
  vx = lost ? 1.0 + RegisterDoubles{} : vx * inverse_length;
  vy *= inverse_length;
  vz *= inverse_length;

  // u and w span the plane across v.
  const RegisterDoubles vxx = vx * vx, vzz = vz * vz;
  const auto flat = vxx > vzz;
  RegisterDoubles ux = flat ? -vy : RegisterDoubles{}, uy = flat ? vx : -vz, uz = flat ? RegisterDoubles{} : vy;
  RegisterDoubles u_length = ux * ux + uy * uy + uz * uz;
  take_square_root(u_length);
  const RegisterDoubles inverse_u = 1.0 / u_length;
  ux *= inverse_u;
  uy *= inverse_u;
  uz *= inverse_u;
  const RegisterDoubles wx = vy * uz - vz * uy, wy = vz * ux - vx * uz, wz = vx * uy - vy * ux;

  // The 2x2 matrix [low_side turn; turn high_side] of the map in (u, w), made diagonal by one rotation of tangent k.
  const RegisterDoubles mux = a * ux + d * uy + e * uz, muy = d * ux + b * uy + f * uz, muz = e * ux + f * uy + c * uz;
  const RegisterDoubles mwx = a * wx + d * wy + e * wz, mwy = d * wx + b * wy + f * wz, mwz = e * wx + f * wy + c * wz;
  const RegisterDoubles low_side = ux * mux + uy * muy + uz * muz, high_side = wx * mwx + wy * mwy + wz * mwz;
  const RegisterDoubles turn = ux * mwx + uy * mwy + uz * mwz;
  const RegisterDoubles difference = high_side - low_side;
  RegisterDoubles root = difference * difference + 4.0 * turn * turn;
  take_square_root(root);
  const RegisterDoubles divisor = difference < 0.0 ? difference - root : difference + root;
  const RegisterDoubles k =
      root > 0.0 ? 2.0 * turn / (root > 0.0 ? divisor : 1.0 + RegisterDoubles{}) : RegisterDoubles{};
  RegisterDoubles cosine = 1.0 + k * k;
  take_square_root(cosine);
  cosine = 1.0 / cosine;
  const RegisterDoubles sine = k * cosine;
  const RegisterDoubles first = low_side - k * turn, second = high_side + k * turn;
  const auto swapped = first > second;
  const RegisterDoubles low = swapped ? second : first, high = swapped ? first : second;
  const RegisterDoubles minor_u = swapped ? sine : cosine, minor_w = swapped ? cosine : -sine;

  const RegisterDoubles mvx = a * vx + d * vy + e * vz, mvy = d * vx + b * vy + f * vz, mvz = e * vx + f * vy + c * vz;
  const RegisterDoubles alone = vx * mvx + vy * mvy + vz * mvz;
  const RegisterDoubles nx = negative ? vx : minor_u * ux + minor_w * wx;
  const RegisterDoubles ny = negative ? vy : minor_u * uy + minor_w * wy;
  const RegisterDoubles nz = negative ? vz : minor_u * uz + minor_w * wz;
  eigen.vector[0] = isotropic ? 1.0 + RegisterDoubles{} : nx;
  eigen.vector[1] = isotropic ? RegisterDoubles{} : ny;
  eigen.vector[2] = isotropic ? RegisterDoubles{} : nz;
  eigen.values[0] = (isotropic ? mean : mean + (negative ? alone : low)) * scale;
  eigen.values[1] = (isotropic ? mean : mean + (negative ? low : high)) * scale;
  eigen.values[2] = (isotropic ? mean : mean + (negative ? high : alone)) * scale;
}

/// The same for all lanes.
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
    least_eigenvectors({some(matrices.xx), some(matrices.xy), some(matrices.xz), some(matrices.yy), some(matrices.yz),
                        some(matrices.zz)},
                       found);
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
