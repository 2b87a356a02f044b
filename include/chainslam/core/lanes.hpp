#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <numbers>
#include <type_traits>

#if defined(__SSE2__)
#include <emmintrin.h>
#elif defined(__aarch64__) && defined(__ARM_NEON)
#include <arm_neon.h>
#endif

namespace chainslam::detail {

// Vectors of the compiler's own, as wide as its registers: plain arithmetic on them is SIMD at any level of
// optimization, on any processor. They go by reference, since how they are passed by value depends on flags.

#if defined(__AVX__)
inline constexpr std::size_t lane_count = 8;
#else
inline constexpr std::size_t lane_count = 4;
#endif

using FloatLanes = float __attribute__((vector_size(lane_count * sizeof(float))));
using MaskLanes =
    std::int32_t __attribute__((vector_size(lane_count * sizeof(std::int32_t))));  ///< -1 for true, 0 for false

/// The least multiple of `lane_count` that is not below `count`.
[[nodiscard]] constexpr std::size_t whole_lanes(std::size_t count) {
  return (count + lane_count - 1) / lane_count * lane_count;
}

inline void load(const float* from, FloatLanes& to) { std::memcpy(&to, from, sizeof to); }
inline void store(const FloatLanes& from, float* to) { std::memcpy(to, &from, sizeof from); }

/// `to` becomes `yes` where the mask is true and `no` elsewhere.
inline void choose(const MaskLanes& mask, const FloatLanes& yes, const FloatLanes& no, FloatLanes& to) {
  MaskLanes yes_bits, no_bits;
  std::memcpy(&yes_bits, &yes, sizeof yes_bits);
  std::memcpy(&no_bits, &no, sizeof no_bits);
  const MaskLanes bits = (mask & yes_bits) | (~mask & no_bits);
  std::memcpy(&to, &bits, sizeof to);
}

/// `to` becomes -x where the mask is true.
inline void negate_where(const MaskLanes& mask, const FloatLanes& x, FloatLanes& to) {
  MaskLanes bits;
  std::memcpy(&bits, &x, sizeof bits);
  bits ^= mask & INT32_MIN;
  std::memcpy(&to, &bits, sizeof to);
}

/// 1 / sqrt(x) to the last bits of float, for positive normal x: Newton's method from the well-known guess by the
/// exponent. 0 gives something finite.
inline void inverse_root(const FloatLanes& x, FloatLanes& to) {
  MaskLanes bits;
  std::memcpy(&bits, &x, sizeof bits);
  bits = 0x5f375a86 - (bits >> 1);
  FloatLanes y;
  std::memcpy(&y, &bits, sizeof y);
  const FloatLanes half = x * 0.5F;
  for (int step = 0; step < 3; ++step) y = y * (1.5F - half * y * y);
  to = y;
}

[[nodiscard]] inline std::int32_t sum(const MaskLanes& values) {
  std::int32_t total = 0;
  for (std::size_t lane = 0; lane < lane_count; ++lane) total += values[lane];
  return total;
}

/// Whether the mask is true anywhere.
[[nodiscard]] inline bool any(const MaskLanes& mask) {
  std::uint64_t bits = 0;
  for (std::size_t lane = 0; lane < lane_count; lane += 2) {
    std::uint64_t two;
    std::memcpy(&two, reinterpret_cast<const char*>(&mask) + lane * sizeof(std::int32_t), sizeof two);
    bits |= two;
  }
  return bits != 0;
}

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

inline void take_square_root(FloatLanes& v) {
  for (std::size_t i = 0; i < lane_count; i += 4) {
    float* at = reinterpret_cast<float*>(&v) + i;
#if defined(__SSE2__)
    _mm_storeu_ps(at, _mm_sqrt_ps(_mm_loadu_ps(at)));
#elif defined(__aarch64__) && defined(__ARM_NEON)
    vst1q_f32(at, vsqrtq_f32(vld1q_f32(at)));
#else
    for (std::size_t lane = 0; lane < 4; ++lane) at[lane] = std::sqrt(at[lane]);
#endif
  }
}

/// A symmetric 3x3 matrix in each lane.
template <class Numbers>
struct SymmetricMatrices {
  Numbers xx, xy, xz, yy, yz, zz;
};

/// Of symmetric matrices the eigenvalues, ascending, and a unit eigenvector of the smallest.
template <class Numbers>
struct LeastEigen {
  std::array<Numbers, 3> values;
  std::array<Numbers, 3> vector;
};

/// The same, and one of the largest.
template <class Numbers>
struct OuterEigen : LeastEigen<Numbers> {
  std::array<Numbers, 3> largest;
};

/// `symmetric_eigen` (see there) for as many matrices as registers have lanes, without branches. Equal eigenvalues give
/// the x axis, and the z axis for the largest. Errors of the order of the rounding of the largest eigenvalue.
///
/// @tparam Found  `LeastEigen` or `OuterEigen` of `Numbers`, which are `RegisterDoubles` or `FloatLanes`.
template <class Numbers, class Found>
void eigenvectors(const SymmetricMatrices<Numbers>& matrix, Found& eigen) {
  using Number = std::remove_cvref_t<decltype(matrix.xx[0])>;
  constexpr Number zero = 0, half = 0.5, one = 1, two = 2, three = 3, third = Number(1) / 3, sixth = Number(1) / 6;
  constexpr Number no_axis = sizeof(Number) == sizeof(double) ? Number(1e-16) : Number(5e-8);
  const Numbers zeros{}, ones = one + zeros;
  const auto larger = [](const Numbers& a, Numbers& most) {
    const Numbers magnitude = a < zero ? -a : a;
    most = magnitude > most ? magnitude : most;
  };
  Numbers scale = 4 * std::numeric_limits<Number>::min() + zeros;
  for (const Numbers* entry : {&matrix.xx, &matrix.xy, &matrix.xz, &matrix.yy, &matrix.yz, &matrix.zz})
    larger(*entry, scale);
  const Numbers inverse_scale = one / scale;
  const Numbers d = matrix.xy * inverse_scale, e = matrix.xz * inverse_scale, f = matrix.yz * inverse_scale;
  const Numbers mean = (matrix.xx + matrix.yy + matrix.zz) * inverse_scale * third;
  const Numbers a = matrix.xx * inverse_scale - mean, b = matrix.yy * inverse_scale - mean;
  const Numbers c = matrix.zz * inverse_scale - mean;
  Numbers p = (a * a + b * b + c * c + two * (d * d + e * e + f * f)) * sixth;
  take_square_root(p);
  const auto isotropic = p <= no_axis;
  p = isotropic ? ones : p;

  // The isolated eigenvalue, p times the outermost root of x^3 - 3 x = det: a polynomial, and Newton's method twice.
  const Numbers half_det = half * (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)) / (p * p * p);
  const auto negative = half_det < zero;
  Numbers h = negative ? -half_det : half_det;
  h = h > one ? ones : h;
  Numbers x =
      std::numbers::sqrt3_v<Number> + h * (third + h * (Number(-0.0935) + h * (Number(0.03658) - Number(0.00846) * h)));
  for (int step = 0; step < 2; ++step) x = (two * x * x * x + two * h) / (three * x * x - three);
  const Numbers isolated = negative ? -p * x : p * x;

  // Its eigenvector v: the longest cross product of two rows of what it leaves singular.
  const Numbers r = a - isolated, s = b - isolated, t = c - isolated;
  Numbers vx = d * f - e * s, vy = e * d - r * f, vz = r * s - d * d;
  Numbers length = vx * vx + vy * vy + vz * vz;
  const auto take_longer = [&](const Numbers& ox, const Numbers& oy, const Numbers& oz) {
    const Numbers other = ox * ox + oy * oy + oz * oz;
    const auto longer = other > length;
    vx = longer ? ox : vx;
    vy = longer ? oy : vy;
    vz = longer ? oz : vz;
    length = longer ? other : length;
  };
  take_longer(s * t - f * f, f * e - d * t, d * f - s * e);
  take_longer(f * e - t * d, t * r - e * e, e * d - f * r);
  take_square_root(length);
  const auto lost = !(length > zero);
  const Numbers inverse_length = one / (lost ? ones : length);
  vx = lost ? ones : vx * inverse_length;
  vy *= inverse_length;
  vz *= inverse_length;

  // u and w span the plane across v.
  const Numbers vxx = vx * vx, vzz = vz * vz;
  const auto flat = vxx > vzz;
  Numbers ux = flat ? -vy : zeros, uy = flat ? vx : -vz, uz = flat ? zeros : vy;
  Numbers u_length = ux * ux + uy * uy + uz * uz;
  take_square_root(u_length);
  const Numbers inverse_u = one / u_length;
  ux *= inverse_u;
  uy *= inverse_u;
  uz *= inverse_u;
  const Numbers wx = vy * uz - vz * uy, wy = vz * ux - vx * uz, wz = vx * uy - vy * ux;

  // The 2x2 matrix [low_side turn; turn high_side] of the map in (u, w), made diagonal by one rotation of tangent k.
  const Numbers mux = a * ux + d * uy + e * uz, muy = d * ux + b * uy + f * uz, muz = e * ux + f * uy + c * uz;
  const Numbers mwx = a * wx + d * wy + e * wz, mwy = d * wx + b * wy + f * wz, mwz = e * wx + f * wy + c * wz;
  const Numbers low_side = ux * mux + uy * muy + uz * muz, high_side = wx * mwx + wy * mwy + wz * mwz;
  const Numbers turn = ux * mwx + uy * mwy + uz * mwz;
  const Numbers difference = high_side - low_side;
  Numbers root = difference * difference + (two * two) * turn * turn;
  take_square_root(root);
  const Numbers divisor = difference < zero ? difference - root : difference + root;
  const Numbers k = root > zero ? two * turn / (root > zero ? divisor : ones) : zeros;
  Numbers cosine = one + k * k;
  take_square_root(cosine);
  cosine = one / cosine;
  const Numbers sine = k * cosine;
  const Numbers first = low_side - k * turn, second = high_side + k * turn;
  const auto swapped = first > second;
  const Numbers low = swapped ? second : first, high = swapped ? first : second;
  const Numbers minor_u = swapped ? sine : cosine, minor_w = swapped ? cosine : -sine;

  const Numbers mvx = a * vx + d * vy + e * vz, mvy = d * vx + b * vy + f * vz, mvz = e * vx + f * vy + c * vz;
  const Numbers alone = vx * mvx + vy * mvy + vz * mvz;
  const Numbers nx = negative ? vx : minor_u * ux + minor_w * wx;
  const Numbers ny = negative ? vy : minor_u * uy + minor_w * wy;
  const Numbers nz = negative ? vz : minor_u * uz + minor_w * wz;
  eigen.vector[0] = isotropic ? ones : nx;
  eigen.vector[1] = isotropic ? zeros : ny;
  eigen.vector[2] = isotropic ? zeros : nz;
  if constexpr (requires { eigen.largest; }) {
    const Numbers major_u = swapped ? cosine : sine, major_w = swapped ? -sine : cosine;
    eigen.largest[0] = isotropic ? zeros : (negative ? major_u * ux + major_w * wx : vx);
    eigen.largest[1] = isotropic ? zeros : (negative ? major_u * uy + major_w * wy : vy);
    eigen.largest[2] = isotropic ? ones : (negative ? major_u * uz + major_w * wz : vz);
  }
  eigen.values[0] = (isotropic ? mean : mean + (negative ? alone : low)) * scale;
  eigen.values[1] = (isotropic ? mean : mean + (negative ? low : high)) * scale;
  eigen.values[2] = (isotropic ? mean : mean + (negative ? high : alone)) * scale;
}

}  // namespace chainslam::detail
