#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <type_traits>

#include "chainslam/search/detail/intrinsics.hpp"

namespace chainslam::detail {

inline constexpr std::size_t pack_width = 8;

template <class Scalar>
using KeyBits = std::conditional_t<sizeof(Scalar) == 4, std::uint32_t, std::uint64_t>;

/// The largest finite number with room for a lane's number: what is farther is never found.
template <class Scalar>
inline constexpr Scalar far_key =
    std::bit_cast<Scalar>(std::bit_cast<KeyBits<Scalar>>(std::numeric_limits<Scalar>::max()) & ~KeyBits<Scalar>{7});

/// The lane whose number a key carries.
template <class Scalar>
[[nodiscard]] std::size_t lane_of(Scalar key) {
  return static_cast<std::size_t>(std::bit_cast<KeyBits<Scalar>>(key) & 7U);
}

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
  friend Pack min(const Pack& a, const Pack& b) {
    return each([&](std::size_t i) { return a.values[i] < b.values[i] ? a.values[i] : b.values[i]; });
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
  /// Bit i is set where value i is at least `bound`.
  [[nodiscard]] unsigned at_least(Scalar bound) const {
    unsigned mask = 0;
    for (std::size_t i = 0; i < pack_width; ++i) mask |= static_cast<unsigned>(values[i] >= bound) << i;
    return mask;
  }
  /// The smallest value; none is NaN.
  [[nodiscard]] Scalar smallest() const {
    Scalar least = values[0];
    for (std::size_t i = 1; i < pack_width; ++i) least = values[i] < least ? values[i] : least;
    return least;
  }
  /// The values, not negative and not NaN, with their lanes' numbers in the last three bits, which takes a trifle off
  /// them; all that exceeds `far_key` is taken for that.
  [[nodiscard]] Pack keys() const {
    return each([&](std::size_t i) {
      const Scalar value = values[i] < far_key<Scalar> ? values[i] : far_key<Scalar>;
      return std::bit_cast<Scalar>((std::bit_cast<KeyBits<Scalar>>(value) & ~KeyBits<Scalar>{7}) |
                                   static_cast<KeyBits<Scalar>>(i));
    });
  }
  /// The smallest value that exceeds `last`, or `far_key`.
  [[nodiscard]] Scalar smallest_above(Scalar last) const {
    return each([&](std::size_t i) { return values[i] > last ? values[i] : far_key<Scalar>; }).smallest();
  }
  /// The k-th smallest value, k of 1 to 8; none is NaN.
  [[nodiscard]] Scalar smallest(int k) const {
    Pack at_most_so_many = all(std::numeric_limits<Scalar>::infinity());
    for (std::size_t i = 0; i < pack_width; ++i) {
      int count = 0;
      for (std::size_t j = 0; j < pack_width; ++j) count += values[j] <= values[i] ? 1 : 0;
      if (count >= k) at_most_so_many.values[i] = values[i];
    }
    return at_most_so_many.smallest();
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
  friend Pack min(const Pack& a, const Pack& b) { return {_mm256_min_ps(a.values, b.values)}; }
  friend Pack max(const Pack& a, const Pack& b) { return {_mm256_max_ps(a.values, b.values)}; }
  [[nodiscard]] unsigned below(float bound) const {
    return static_cast<unsigned>(_mm256_movemask_ps(_mm256_cmp_ps(values, _mm256_set1_ps(bound), _CMP_LT_OQ)));
  }
  [[nodiscard]] unsigned at_most(float bound) const {
    return static_cast<unsigned>(_mm256_movemask_ps(_mm256_cmp_ps(values, _mm256_set1_ps(bound), _CMP_LE_OQ)));
  }
  [[nodiscard]] unsigned at_least(float bound) const {
    return static_cast<unsigned>(_mm256_movemask_ps(_mm256_cmp_ps(values, _mm256_set1_ps(bound), _CMP_GE_OQ)));
  }
  [[nodiscard]] float smallest() const {
    __m128 least = _mm_min_ps(_mm256_castps256_ps128(values), _mm256_extractf128_ps(values, 1));
    least = _mm_min_ps(least, _mm_movehl_ps(least, least));
    return _mm_cvtss_f32(_mm_min_ss(least, _mm_shuffle_ps(least, least, 1)));
  }
  [[nodiscard]] Pack keys() const {
    const __m256 high_bits = _mm256_castsi256_ps(_mm256_set1_epi32(~7));
    const __m256 lanes = _mm256_castsi256_ps(_mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7));
    const __m256 near = _mm256_min_ps(values, _mm256_set1_ps(far_key<float>));
    return {_mm256_or_ps(_mm256_and_ps(near, high_bits), lanes)};
  }
  [[nodiscard]] float smallest_above(float last) const {
    const __m256 above = _mm256_cmp_ps(values, _mm256_set1_ps(last), _CMP_GT_OQ);
    return Pack{_mm256_blendv_ps(_mm256_set1_ps(far_key<float>), values, above)}.smallest();
  }
  [[nodiscard]] float smallest(int k) const {
    alignas(32) std::array<float, pack_width> each;
    store(each.data());
    const __m256 one = _mm256_set1_ps(1);
    __m256 count = _mm256_setzero_ps(), other_count = _mm256_setzero_ps();
    for (std::size_t j = 0; j < pack_width; j += 2) {
      const __m256 first = _mm256_cmp_ps(_mm256_set1_ps(each[j]), values, _CMP_LE_OQ);
      const __m256 second = _mm256_cmp_ps(_mm256_set1_ps(each[j + 1]), values, _CMP_LE_OQ);
      count = _mm256_add_ps(count, _mm256_and_ps(first, one));
      other_count = _mm256_add_ps(other_count, _mm256_and_ps(second, one));
    }
    count = _mm256_add_ps(count, other_count);
    const __m256 enough = _mm256_cmp_ps(count, _mm256_set1_ps(static_cast<float>(k)), _CMP_GE_OQ);
    const __m256 infinite = _mm256_set1_ps(std::numeric_limits<float>::infinity());
    return Pack{_mm256_blendv_ps(infinite, values, enough)}.smallest();
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
  friend Pack min(const Pack& a, const Pack& b) { return {_mm_min_ps(a.low, b.low), _mm_min_ps(a.high, b.high)}; }
  friend Pack max(const Pack& a, const Pack& b) { return {_mm_max_ps(a.low, b.low), _mm_max_ps(a.high, b.high)}; }
  [[nodiscard]] unsigned below(float bound) const {
    const __m128 limit = _mm_set1_ps(bound);
    return mask(_mm_cmplt_ps(low, limit), _mm_cmplt_ps(high, limit));
  }
  [[nodiscard]] unsigned at_most(float bound) const {
    const __m128 limit = _mm_set1_ps(bound);
    return mask(_mm_cmple_ps(low, limit), _mm_cmple_ps(high, limit));
  }
  [[nodiscard]] unsigned at_least(float bound) const {
    const __m128 limit = _mm_set1_ps(bound);
    return mask(_mm_cmpge_ps(low, limit), _mm_cmpge_ps(high, limit));
  }
  [[nodiscard]] float smallest() const {
    __m128 least = _mm_min_ps(low, high);
    least = _mm_min_ps(least, _mm_movehl_ps(least, least));
    return _mm_cvtss_f32(_mm_min_ss(least, _mm_shuffle_ps(least, least, 1)));
  }
  [[nodiscard]] Pack keys() const {
    const __m128 high_bits = _mm_castsi128_ps(_mm_set1_epi32(~7)), far = _mm_set1_ps(far_key<float>);
    const __m128 first = _mm_castsi128_ps(_mm_setr_epi32(0, 1, 2, 3));
    const __m128 second = _mm_castsi128_ps(_mm_setr_epi32(4, 5, 6, 7));
    return {_mm_or_ps(_mm_and_ps(_mm_min_ps(low, far), high_bits), first),
            _mm_or_ps(_mm_and_ps(_mm_min_ps(high, far), high_bits), second)};
  }
  [[nodiscard]] float smallest_above(float last) const {
    const __m128 limit = _mm_set1_ps(last), far = _mm_set1_ps(far_key<float>);
    const auto above = [&](__m128 part) {
      const __m128 taken = _mm_cmpgt_ps(part, limit);
      return _mm_or_ps(_mm_and_ps(taken, part), _mm_andnot_ps(taken, far));
    };
    return Pack{above(low), above(high)}.smallest();
  }
  [[nodiscard]] float smallest(int k) const {
    alignas(32) std::array<float, pack_width> each;
    store(each.data());
    const __m128 one = _mm_set1_ps(1);
    __m128 count_low = _mm_setzero_ps(), count_high = _mm_setzero_ps();
    for (std::size_t j = 0; j < pack_width; ++j) {
      const __m128 value = _mm_set1_ps(each[j]);
      count_low = _mm_add_ps(count_low, _mm_and_ps(_mm_cmple_ps(value, low), one));
      count_high = _mm_add_ps(count_high, _mm_and_ps(_mm_cmple_ps(value, high), one));
    }
    const __m128 wanted = _mm_set1_ps(static_cast<float>(k));
    const __m128 infinite = _mm_set1_ps(std::numeric_limits<float>::infinity());
    const auto enough = [&](__m128 part, __m128 count) {
      const __m128 taken = _mm_cmpge_ps(count, wanted);
      return _mm_or_ps(_mm_and_ps(taken, part), _mm_andnot_ps(taken, infinite));
    };
    return Pack{enough(low, count_low), enough(high, count_high)}.smallest();
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

#elif defined(__aarch64__) && defined(__ARM_NEON)

template <>
struct Pack<float> {
  float32x4_t low, high;

  static Pack load(const float* from) { return {vld1q_f32(from), vld1q_f32(from + 4)}; }
  static Pack all(float value) { return {vdupq_n_f32(value), vdupq_n_f32(value)}; }
  void store(float* to) const {
    vst1q_f32(to, low);
    vst1q_f32(to + 4, high);
  }
  friend Pack operator+(const Pack& a, const Pack& b) { return {vaddq_f32(a.low, b.low), vaddq_f32(a.high, b.high)}; }
  friend Pack operator-(const Pack& a, const Pack& b) { return {vsubq_f32(a.low, b.low), vsubq_f32(a.high, b.high)}; }
  friend Pack operator*(const Pack& a, const Pack& b) { return {vmulq_f32(a.low, b.low), vmulq_f32(a.high, b.high)}; }
  // By a comparison: NEON's own minimum answers NaN where either is, those of other processors the second.
  friend Pack min(const Pack& a, const Pack& b) {
    return {vbslq_f32(vcltq_f32(a.low, b.low), a.low, b.low), vbslq_f32(vcltq_f32(a.high, b.high), a.high, b.high)};
  }
  friend Pack max(const Pack& a, const Pack& b) {
    return {vbslq_f32(vcgtq_f32(a.low, b.low), a.low, b.low), vbslq_f32(vcgtq_f32(a.high, b.high), a.high, b.high)};
  }
  [[nodiscard]] unsigned below(float bound) const {
    const float32x4_t limit = vdupq_n_f32(bound);
    return mask(vcltq_f32(low, limit), vcltq_f32(high, limit));
  }
  [[nodiscard]] unsigned at_most(float bound) const {
    const float32x4_t limit = vdupq_n_f32(bound);
    return mask(vcleq_f32(low, limit), vcleq_f32(high, limit));
  }
  [[nodiscard]] unsigned at_least(float bound) const {
    const float32x4_t limit = vdupq_n_f32(bound);
    return mask(vcgeq_f32(low, limit), vcgeq_f32(high, limit));
  }
  [[nodiscard]] float smallest() const { return vminvq_f32(vminq_f32(low, high)); }
  [[nodiscard]] Pack keys() const {
    const Pack near = min(*this, all(far_key<float>));
    const uint32x4_t high_bits = vdupq_n_u32(~7U), first{0, 1, 2, 3}, second{4, 5, 6, 7};
    const auto key = [&](float32x4_t part, uint32x4_t lanes) {
      return vreinterpretq_f32_u32(vorrq_u32(vandq_u32(vreinterpretq_u32_f32(part), high_bits), lanes));
    };
    return {key(near.low, first), key(near.high, second)};
  }
  [[nodiscard]] float smallest_above(float last) const {
    const float32x4_t limit = vdupq_n_f32(last), far = vdupq_n_f32(far_key<float>);
    return Pack{vbslq_f32(vcgtq_f32(low, limit), low, far), vbslq_f32(vcgtq_f32(high, limit), high, far)}.smallest();
  }
  [[nodiscard]] float smallest(int k) const {
    alignas(32) std::array<float, pack_width> each;
    store(each.data());
    uint32x4_t count_low = vdupq_n_u32(0), count_high = vdupq_n_u32(0);
    for (const float one : each) {  // a comparison that holds is -1
      const float32x4_t value = vdupq_n_f32(one);
      count_low = vsubq_u32(count_low, vcleq_f32(value, low));
      count_high = vsubq_u32(count_high, vcleq_f32(value, high));
    }
    const uint32x4_t wanted = vdupq_n_u32(static_cast<unsigned>(k));
    const float32x4_t infinite = vdupq_n_f32(std::numeric_limits<float>::infinity());
    return Pack{vbslq_f32(vcgeq_u32(count_low, wanted), low, infinite),
                vbslq_f32(vcgeq_u32(count_high, wanted), high, infinite)}
        .smallest();
  }
  [[nodiscard]] unsigned find(float value) const {
    const float32x4_t wanted = vdupq_n_f32(value);
    return static_cast<unsigned>(std::countr_zero(mask(vceqq_f32(low, wanted), vceqq_f32(high, wanted))));
  }

 private:
  static unsigned mask(uint32x4_t first, uint32x4_t second) {
    const uint32x4_t first_bits{1, 2, 4, 8}, second_bits{16, 32, 64, 128};
    return vaddvq_u32(vorrq_u32(vandq_u32(first, first_bits), vandq_u32(second, second_bits)));
  }
};

#endif

}  // namespace chainslam::detail
