#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>

#if defined(__AVX__) || defined(__SSE2__)
#include <immintrin.h>
#endif

namespace chainslam::detail {

inline constexpr std::size_t pack_width = 8;

/// Eight numbers at a time, in what registers there are.
template <class Scalar>
struct Pack {
  std::array<Scalar, pack_width> values;

  static Pack load(const Scalar* from) {
    Pack p;
    for (std::size_t i = 0; i < pack_width; ++i) p.values[i] = from[i];
    return p;
  }
  static Pack all(Scalar value) {
    Pack p;
    p.values.fill(value);
    return p;
  }
  void store(Scalar* to) const {
    for (std::size_t i = 0; i < pack_width; ++i) to[i] = values[i];
  }
  friend Pack operator+(const Pack& a, const Pack& b) {
    return each([&](std::size_t i) { return a.values[i] + b.values[i]; });
  }
  friend Pack operator-(const Pack& a, const Pack& b) {
    return each([&](std::size_t i) { return a.values[i] - b.values[i]; });
  }
  friend Pack operator*(const Pack& a, const Pack& b) {
    return each([&](std::size_t i) { return a.values[i] * b.values[i]; });
  }
  friend Pack max(const Pack& a, const Pack& b) {
    return each([&](std::size_t i) { return a.values[i] > b.values[i] ? a.values[i] : b.values[i]; });
  }
  /// Bit i is set where value i is below `bound`.
  [[nodiscard]] unsigned below(Scalar bound) const {
    unsigned mask = 0;
    for (std::size_t i = 0; i < pack_width; ++i) mask |= static_cast<unsigned>(values[i] < bound) << i;
    return mask;
  }
  /// Bit i is set where value i is at most `bound`.
  [[nodiscard]] unsigned at_most(Scalar bound) const {
    unsigned mask = 0;
    for (std::size_t i = 0; i < pack_width; ++i) mask |= static_cast<unsigned>(values[i] <= bound) << i;
    return mask;
  }
  /// The smallest value; none is NaN.
  [[nodiscard]] Scalar smallest() const {
    Scalar least = values[0];
    for (std::size_t i = 1; i < pack_width; ++i) least = values[i] < least ? values[i] : least;
    return least;
  }
  /// Where `value` first stands; it does.
  [[nodiscard]] unsigned find(Scalar value) const {
    unsigned mask = 0;
    for (std::size_t i = 0; i < pack_width; ++i) mask |= static_cast<unsigned>(values[i] == value) << i;
    return static_cast<unsigned>(std::countr_zero(mask));
  }

 private:
  template <class Value>
  static Pack each(Value&& value) {
    Pack p;
    for (std::size_t i = 0; i < pack_width; ++i) p.values[i] = value(i);
    return p;
  }
};

#if defined(__AVX__)

template <>
struct Pack<float> {
  __m256 values;

  static Pack load(const float* from) { return {_mm256_load_ps(from)}; }
  static Pack all(float value) { return {_mm256_set1_ps(value)}; }
  void store(float* to) const { _mm256_store_ps(to, values); }
  friend Pack operator+(const Pack& a, const Pack& b) { return {_mm256_add_ps(a.values, b.values)}; }
  friend Pack operator-(const Pack& a, const Pack& b) { return {_mm256_sub_ps(a.values, b.values)}; }
  friend Pack operator*(const Pack& a, const Pack& b) { return {_mm256_mul_ps(a.values, b.values)}; }
  friend Pack max(const Pack& a, const Pack& b) { return {_mm256_max_ps(a.values, b.values)}; }
  [[nodiscard]] unsigned below(float bound) const {
    return static_cast<unsigned>(_mm256_movemask_ps(_mm256_cmp_ps(values, _mm256_set1_ps(bound), _CMP_LT_OQ)));
  }
  [[nodiscard]] unsigned at_most(float bound) const {
    return static_cast<unsigned>(_mm256_movemask_ps(_mm256_cmp_ps(values, _mm256_set1_ps(bound), _CMP_LE_OQ)));
  }
  [[nodiscard]] float smallest() const {
    __m128 least = _mm_min_ps(_mm256_castps256_ps128(values), _mm256_extractf128_ps(values, 1));
    least = _mm_min_ps(least, _mm_movehl_ps(least, least));
    return _mm_cvtss_f32(_mm_min_ss(least, _mm_shuffle_ps(least, least, 1)));
  }
  [[nodiscard]] unsigned find(float value) const {
    const __m256 equal = _mm256_cmp_ps(values, _mm256_set1_ps(value), _CMP_EQ_OQ);
    return static_cast<unsigned>(std::countr_zero(static_cast<unsigned>(_mm256_movemask_ps(equal))));
  }
};

#elif defined(__SSE2__)

template <>
struct Pack<float> {
  __m128 low, high;

  static Pack load(const float* from) { return {_mm_load_ps(from), _mm_load_ps(from + 4)}; }
  static Pack all(float value) { return {_mm_set1_ps(value), _mm_set1_ps(value)}; }
  void store(float* to) const {
    _mm_store_ps(to, low);
    _mm_store_ps(to + 4, high);
  }
  friend Pack operator+(const Pack& a, const Pack& b) { return {_mm_add_ps(a.low, b.low), _mm_add_ps(a.high, b.high)}; }
  friend Pack operator-(const Pack& a, const Pack& b) { return {_mm_sub_ps(a.low, b.low), _mm_sub_ps(a.high, b.high)}; }
  friend Pack operator*(const Pack& a, const Pack& b) { return {_mm_mul_ps(a.low, b.low), _mm_mul_ps(a.high, b.high)}; }
  friend Pack max(const Pack& a, const Pack& b) { return {_mm_max_ps(a.low, b.low), _mm_max_ps(a.high, b.high)}; }
  [[nodiscard]] unsigned below(float bound) const {
    const __m128 limit = _mm_set1_ps(bound);
    return mask(_mm_cmplt_ps(low, limit), _mm_cmplt_ps(high, limit));
  }
  [[nodiscard]] unsigned at_most(float bound) const {
    const __m128 limit = _mm_set1_ps(bound);
    return mask(_mm_cmple_ps(low, limit), _mm_cmple_ps(high, limit));
  }
  [[nodiscard]] float smallest() const {
    __m128 least = _mm_min_ps(low, high);
    least = _mm_min_ps(least, _mm_movehl_ps(least, least));
    return _mm_cvtss_f32(_mm_min_ss(least, _mm_shuffle_ps(least, least, 1)));
  }
  [[nodiscard]] unsigned find(float value) const {
    const __m128 wanted = _mm_set1_ps(value);
    return static_cast<unsigned>(std::countr_zero(mask(_mm_cmpeq_ps(low, wanted), _mm_cmpeq_ps(high, wanted))));
  }

 private:
  static unsigned mask(__m128 first, __m128 second) {
    return static_cast<unsigned>(_mm_movemask_ps(first)) | static_cast<unsigned>(_mm_movemask_ps(second)) << 4;
  }
};

#endif

}  // namespace chainslam::detail
