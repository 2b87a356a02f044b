#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <type_traits>
#include <vector>

#include "chainslam/search/concepts.hpp"
#include "chainslam/search/detail/pack.hpp"

namespace chainslam::detail {

/// Writes index and distance of the lanes of a mask one after the other; `out` has room for eight, however few there
/// are. Returns how many there are.
template <class Scalar>
std::size_t write_lanes(Neighbor<Scalar>* out, Index first, const Pack<Scalar>& distances, unsigned mask) {
  alignas(64) std::array<Scalar, pack_width> each;
  distances.store(each.data());
  std::size_t count = 0;
  for (std::size_t lane = 0; lane < pack_width; ++lane) {
    out[count] = {first + static_cast<Index>(lane), each[lane]};
    count += mask >> lane & 1U;
  }
  return count;
}

#if defined(__AVX512F__)

template <>
inline std::size_t write_lanes(Neighbor<float>* out, Index first, const Pack<float>& distances, unsigned mask) {
  static_assert(sizeof(Neighbor<float>) == 8 && std::is_trivially_copyable_v<Neighbor<float>>);
  const __m256i indices = _mm256_add_epi32(_mm256_set1_epi32(first), _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7));
  const __m512i in_turn = _mm512_setr_epi32(0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23);
  const __m512i pairs = _mm512_permutex2var_epi32(_mm512_castsi256_si512(indices), in_turn,
                                                  _mm512_castsi256_si512(_mm256_castps_si256(distances.values)));
  _mm512_storeu_si512(out, _mm512_maskz_compress_epi64(static_cast<__mmask8>(mask), pairs));
  return static_cast<std::size_t>(std::popcount(mask));
}

#elif defined(__AVX2__)

/// For each mask of four pairs of 32 bits, the pairs that it names, and then any.
inline constexpr auto pairs_of_mask = [] {
  std::array<std::array<std::int32_t, 8>, 16> order{};
  for (unsigned mask = 0; mask < 16; ++mask) {
    std::size_t place = 0;
    for (std::int32_t pair = 0; pair < 4; ++pair) {
      if ((mask >> pair & 1U) == 0) continue;
      order[mask][place++] = 2 * pair;
      order[mask][place++] = 2 * pair + 1;
    }
  }
  return order;
}();

template <>
inline std::size_t write_lanes(Neighbor<float>* out, Index first, const Pack<float>& distances, unsigned mask) {
  static_assert(sizeof(Neighbor<float>) == 8 && std::is_trivially_copyable_v<Neighbor<float>>);
  const auto write = [out](std::size_t place, __m256i pairs, unsigned taken) {
    const __m256i order = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(pairs_of_mask[taken].data()));
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(out + place), _mm256_permutevar8x32_epi32(pairs, order));
  };
  const __m256i indices = _mm256_add_epi32(_mm256_set1_epi32(first), _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7));
  const __m256i values = _mm256_castps_si256(distances.values);
  const __m256i even = _mm256_unpacklo_epi32(indices, values), odd = _mm256_unpackhi_epi32(indices, values);
  const auto in_first_four = static_cast<std::size_t>(std::popcount(mask & 15U));
  write(0, _mm256_permute2x128_si256(even, odd, 0x20), mask & 15U);
  write(in_first_four, _mm256_permute2x128_si256(even, odd, 0x31), mask >> 4);
  return in_first_four + static_cast<std::size_t>(std::popcount(mask >> 4));
}

#endif

/// Collects every point within a radius, in the caller's memory, which it leaves as long as there are points.
template <class Scalar>
class RadiusList {
 public:
  RadiusList(std::vector<Neighbor<Scalar>>& out, Scalar bound) : out_(out), bound_(bound) {}
  RadiusList(const RadiusList&) = delete;
  RadiusList& operator=(const RadiusList&) = delete;
  ~RadiusList() { out_.resize(size_); }  // never longer: does not throw

  [[nodiscard]] Scalar bound() const { return bound_; }
  void offer(Index index, Scalar squared_distance) {
    make_room(1);
    out_[size_++] = {index, squared_distance};
  }
  /// Of the points `first` + lane, those below the bound. There must be room for eight.
  void offer_lanes(Index first, const Pack<Scalar>& distances) {
    size_ += write_lanes(out_.data() + size_, first, distances, distances.below(bound_));
  }
  void make_room(std::size_t count) {
    if (size_ + count > out_.size()) out_.resize(std::max(2 * out_.size(), std::size_t{64}));
  }

 private:
  std::vector<Neighbor<Scalar>>& out_;
  std::size_t size_ = 0;
  Scalar bound_;
};

}  // namespace chainslam::detail
