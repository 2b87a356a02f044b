#pragma once

#include <cmath>
#include <cstring>
#include <type_traits>
#include <utility>

#include "chainslam/core/table.hpp"

namespace chainslam::detail {

// Kernels on column-major arrays whose columns lie `stride` doubles apart. They work on tiles that stay in registers.
// Loops over a tile are unrolled, since its registers have no addresses: by a pragma where compilers make the same of
// it as of a fold expression, which takes them longer. Where registers are wider than what is compiled for, they are
// not passed by value: compilers warn of that.

/// Doubles in a register of the instruction set that is compiled for.
#if defined(__AVX512F__)
inline constexpr int register_width = 8;
#elif defined(__AVX__)
inline constexpr int register_width = 4;
#else
inline constexpr int register_width = 2;
#endif

template <int Width>
struct RegisterOf {
  typedef double Type __attribute__((vector_size(Width * sizeof(double))));
};
template <>
struct RegisterOf<1> {
  using Type = double;
};
template <int Width>
using Register = typename RegisterOf<Width>::Type;

template <int Width>
[[gnu::always_inline]] inline Register<Width> load(const double* from) {
  Register<Width> value;
  std::memcpy(&value, from, sizeof value);
  return value;
}

template <int Width>
[[gnu::always_inline]] inline void store(double* to, Register<Width> value) {
  std::memcpy(to, &value, sizeof value);
}

/// Calls visit(std::integral_constant<int, k>) for k = 0 ... Count - 1, in this order.
template <int Count, class Visit>
[[gnu::always_inline]] inline void unroll(Visit&& visit) {
  [&]<int... K>(std::integer_sequence<int, K...>) __attribute__((always_inline)) {
    (visit(std::integral_constant<int, K>{}), ...);
  }
  (std::make_integer_sequence<int, Count>{});
}

enum class Accumulate { add, subtract };

/// C += A B^T or C -= A B^T for a tile of `Registers` x Width rows and `Columns` columns; B has `Columns` rows; A and B
/// have `depth` columns.
template <int Width, int Registers, int Columns>
[[gnu::always_inline]] inline void product_tile(Accumulate how, const double* a, Offset a_stride, const double* b,
                                                Offset b_stride, Offset depth, double* c, Offset c_stride) {
#if defined(__clang__) && !defined(__AVX__)
#pragma clang fp contract(off)
#endif
  Register<Width> sum[Registers * Columns] = {};
  for (Offset k = 0; k < depth; ++k, a += a_stride, b += b_stride) {
    Register<Width> left[Registers];
#pragma GCC unroll 12
    for (int r = 0; r < Registers; ++r) std::memcpy(&left[r], a + r * Width, sizeof left[r]);
#pragma GCC unroll 12
    for (int j = 0; j < Columns; ++j) {
#pragma GCC unroll 12
      for (int r = 0; r < Registers; ++r) sum[j * Registers + r] += left[r] * b[j];
    }
  }
#pragma GCC unroll 12
  for (int j = 0; j < Columns; ++j) {
    double* const to = c + j * c_stride;
#pragma GCC unroll 12
    for (int r = 0; r < Registers; ++r) {
      Register<Width> value;
      std::memcpy(&value, to + r * Width, sizeof value);
      if (how == Accumulate::add)
        value += sum[j * Registers + r];
      else
        value -= sum[j * Registers + r];
      std::memcpy(to + r * Width, &value, sizeof value);
    }
  }
}

/// X L^T = C for a tile of one register by N columns, X in the place of C. L is lower triangular; `reciprocals` are
/// those of its diagonal.
template <int Width, int N>
[[gnu::always_inline]] inline void solve_tile(const double* l, Offset l_stride, const double* reciprocals, double* c,
                                              Offset c_stride) {
  Register<Width> x[N];
  unroll<N>([&](auto j) __attribute__((always_inline)) {
    x[j] = load<Width>(c + j * c_stride);
    unroll<j()>([&](auto k) __attribute__((always_inline)) { x[j] -= x[k] * l[k * l_stride + j]; });
    x[j] *= reciprocals[j];
    store<Width>(c + j * c_stride, x[j]);
  });
}

/// The rows that fill registers. @returns how many they are.
template <int Columns, int Width>
[[gnu::always_inline]] inline Offset product_tiles(Accumulate how, Offset rows, const double* a, Offset a_stride,
                                                   const double* b, Offset b_stride, Offset depth, double* c,
                                                   Offset c_stride) {
  // As many rows as leave the sums in registers: 12 of 16 hold them, or with AVX-512 24 of 32, the others the factors.
  constexpr int registers = Columns >= 12 || Width == 1 ? 1 : 12 / Columns;
  Offset row = 0;
  const auto tiles = [&]<int Registers>() __attribute__((always_inline)) {
    for (; row + Registers * Width <= rows; row += Registers * Width)
      product_tile<Width, Registers, Columns>(how, a + row, a_stride, b, b_stride, depth, c + row, c_stride);
  };
  if constexpr (Width == 8 && Columns <= 6) tiles.template operator()<2 * registers>();
  tiles.template operator()<registers>();
  tiles.template operator()<1>();
  return row;
}

#if defined(__x86_64__) && !defined(__AVX__)
/// The same for programs that are to run on any x86-64, by registers that most of these have: bit-identical, since AVX
/// alone rounds as SSE2 does.
template <int Columns>
[[gnu::target("avx")]] Offset product_tiles_by_avx(Accumulate how, Offset rows, const double* a, Offset a_stride,
                                                   const double* b, Offset b_stride, Offset depth, double* c,
                                                   Offset c_stride) {
  return product_tiles<Columns, 4>(how, rows, a, a_stride, b, b_stride, depth, c, c_stride);
}

/// By AVX-512, whose fused multiplications and additions would round once instead of twice: g++ is kept from using them
/// here, clang in `product_tile`.
template <int Columns>
#if !defined(__clang__)
[[gnu::optimize("fp-contract=off")]]
#endif
[[gnu::target("avx512f")]] Offset
product_tiles_by_avx512(Accumulate how, Offset rows, const double* a, Offset a_stride, const double* b, Offset b_stride,
                        Offset depth, double* c, Offset c_stride) {
  return product_tiles<Columns, 8>(how, rows, a, a_stride, b, b_stride, depth, c, c_stride);
}
#endif

/// C += A B^T or C -= A B^T, `rows` x `Columns`, with A `rows` x `depth`, B `Columns` x `depth`. C shares no element
/// with A and B.
template <int Columns, int Width = register_width>
void accumulate_product(Accumulate how, Offset rows, const double* a, Offset a_stride, const double* b, Offset b_stride,
                        Offset depth, double* c, Offset c_stride) {
  Offset row = 0;
#if defined(__x86_64__) && !defined(__AVX__)
  if (Width == 2 && rows >= 8 && __builtin_cpu_supports("avx512f") != 0)
    row = product_tiles_by_avx512<Columns>(how, rows, a, a_stride, b, b_stride, depth, c, c_stride);
  if (Width == 2 && rows - row >= 4 && __builtin_cpu_supports("avx") != 0)
    row += product_tiles_by_avx<Columns>(how, rows - row, a + row, a_stride, b, b_stride, depth, c + row, c_stride);
#endif
  row += product_tiles<Columns, Width>(how, rows - row, a + row, a_stride, b, b_stride, depth, c + row, c_stride);
  if constexpr (Width > 1) {
    if (row < rows)
      accumulate_product<Columns, Width / 2>(how, rows - row, a + row, a_stride, b, b_stride, depth, c + row, c_stride);
  }
}

template <int Columns>
void subtract_product(Offset rows, const double* a, Offset a_stride, const double* b, Offset b_stride, Offset depth,
                      double* c, Offset c_stride) {
  accumulate_product<Columns>(Accumulate::subtract, rows, a, a_stride, b, b_stride, depth, c, c_stride);
}

template <int Columns>
void add_product(Offset rows, const double* a, Offset a_stride, const double* b, Offset b_stride, Offset depth,
                 double* c, Offset c_stride) {
  accumulate_product<Columns>(Accumulate::add, rows, a, a_stride, b, b_stride, depth, c, c_stride);
}

/// X L^T = C, `rows` x N, X in the place of C.
template <int N, int Width = register_width>
void solve_from_right(Offset rows, const double* l, Offset l_stride, const double* reciprocals, double* c,
                      Offset c_stride) {
  Offset row = 0;
  for (; row + Width <= rows; row += Width) solve_tile<Width, N>(l, l_stride, reciprocals, c + row, c_stride);
  if constexpr (Width > 1) {
    if (row < rows) solve_from_right<N, Width / 2>(rows - row, l, l_stride, reciprocals, c + row, c_stride);
  }
}

/// x -= A^T y for N columns of A, with `rows` rows.
template <int N>
void subtract_dots(Offset rows, const double* a, Offset a_stride, const double* y, double* x) {
  // Pairs at the end, since most fronts are a few blocks high.
  constexpr int width = register_width >= 4 ? 4 : 2;
  Register<2> pair[N] = {};
  Offset row = 0;
  if constexpr (width == 4) {
    Register<4> sum[N] = {};
    for (; row + 4 <= rows; row += 4) {
      const Register<4> factor = load<4>(y + row);
      unroll<N>([&](auto j) __attribute__((always_inline)) { sum[j] += load<4>(a + j * a_stride + row) * factor; });
    }
    unroll<N>([&](auto j) __attribute__((always_inline)) {
      pair[j] = Register<2>{sum[j][0] + sum[j][2], sum[j][1] + sum[j][3]};
    });
  }
  for (; row + 2 <= rows; row += 2) {
    const Register<2> factor = load<2>(y + row);
    unroll<N>([&](auto j) __attribute__((always_inline)) { pair[j] += load<2>(a + j * a_stride + row) * factor; });
  }
  unroll<N>([&](auto j) __attribute__((always_inline)) { x[j] -= pair[j][0] + pair[j][1]; });
  for (; row < rows; ++row) {
    for (int j = 0; j < N; ++j) x[j] -= a[j * a_stride + row] * y[row];
  }
}

/// Replaces x by L^-1 x, in registers. L is lower triangular; `reciprocals` are those of its diagonal.
template <int N>
void substitute_block_forward(const double* l, Offset l_stride, const double* reciprocals, double* x) {
  double y[N];
  std::memcpy(y, x, sizeof y);
#pragma GCC unroll 12
  for (int c = 0; c < N; ++c) {
    y[c] *= reciprocals[c];
#pragma GCC unroll 12
    for (int r = c + 1; r < N; ++r) y[r] -= l[c * l_stride + r] * y[c];
  }
  std::memcpy(x, y, sizeof y);
}

/// Replaces x by L^-T x, likewise.
template <int N>
void substitute_block_backward(const double* l, Offset l_stride, const double* reciprocals, double* x) {
  double y[N];
  std::memcpy(y, x, sizeof y);
#pragma GCC unroll 12
  for (int c = N - 1; c >= 0; --c) {
#pragma GCC unroll 12
    for (int r = c + 1; r < N; ++r) y[c] -= l[c * l_stride + r] * y[r];
    y[c] *= reciprocals[c];
  }
  std::memcpy(x, y, sizeof y);
}

/// Cholesky factor of an N x N block in its own place (lower triangle) and the reciprocals of its diagonal.
///
/// @param scale      diagonal of the matrix before elimination; a pivot below `tolerance * scale` counts as zero.
/// @returns false if a pivot is not positive; the block is then invalid.
template <int N>
[[nodiscard]] bool factorize_block(double* block, Offset stride, const double* scale, double tolerance,
                                   double* reciprocals) {
  for (int j = 0; j < N; ++j) {
    double* column = block + j * stride;
    for (int k = 0; k < j; ++k) {
      const double* before = block + k * stride;
      const double factor = before[j];
      for (int i = j; i < N; ++i) column[i] -= before[i] * factor;
    }
    const double pivot = column[j];
    if (!(pivot > tolerance * scale[j]) || !std::isfinite(pivot)) return false;
    const double root = std::sqrt(pivot);
    reciprocals[j] = 1.0 / root;
    column[j] = root;
    for (int i = j + 1; i < N; ++i) column[i] *= reciprocals[j];
  }
  return true;
}

}  // namespace chainslam::detail
