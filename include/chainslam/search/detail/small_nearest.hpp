#pragma once

#include <concepts>
#include <cstddef>
#include <cstdint>
#include <span>
#include <type_traits>

#include "chainslam/search/concepts.hpp"

namespace chainslam::detail {

/// Collects up to eight nearest points, ascending, in registers: a point is put where it belongs by one comparison of
/// all places at once and no branch. Points with d < bound() are worth offering, others are refused; of equal ones the
/// first stays.
///
/// The answers end at the last place; the places before them are held by distances below all others.
template <class Scalar>
class SmallNearest {
 public:
  static constexpr int max_k = 8;
#if defined(__AVX__)
  /// Whether an offer costs less than a branch that is often mispredicted: it does where all places fit one register.
  static constexpr bool offers_are_cheap = true;
#else
  static constexpr bool offers_are_cheap = false;
#endif

  /// @param k  0 to `max_k`.
  SmallNearest(std::size_t k, Scalar bound) : k_(k) {
    for (int i = 0; i < max_k; ++i) {
      distances_[i] = i < max_k - static_cast<int>(k) ? -1 : bound;
      indices_[i] = -1;
    }
    if (k == 0) distances_[max_k - 1] = 0;
  }

  [[nodiscard]] Scalar bound() const { return distances_[max_k - 1]; }
  [[nodiscard]] std::size_t k() const { return k_; }

  void offer(Index index, Scalar squared_distance) {
    const Distances offered = squared_distance - Distances{};
    const Distances before = Scalar(-1) - Distances{};
    const Distances moved_up = __builtin_shufflevector(distances_, before, 8, 0, 1, 2, 3, 4, 5, 6);
    const Indices index_moved_up = __builtin_shufflevector(indices_, indices_, 0, 0, 1, 2, 3, 4, 5, 6);
    const Indices stays = distances_ <= offered;
    const Indices here = moved_up <= offered;
    const Indices added = static_cast<Integer>(index) - Indices{};
    indices_ = stays ? indices_ : (here ? added : index_moved_up);
    distances_ = stays ? distances_ : (here ? offered : moved_up);
  }

  /// Writes the answers to the front of `out`, which has k places. Returns how many there are.
  Index write(std::span<Neighbor<Scalar>> out) const {
    Index count = 0;
    for (std::size_t i = 0; i < out.size(); ++i) {
      const auto place = static_cast<int>(i) + max_k - static_cast<int>(out.size());
      if (indices_[place] < 0) break;
      out[i] = {static_cast<Index>(indices_[place]), distances_[place]};
      ++count;
    }
    return count;
  }

 private:
  using Integer = std::conditional_t<sizeof(Scalar) == 4, std::int32_t, std::int64_t>;
  typedef Scalar Distances __attribute__((vector_size(max_k * sizeof(Scalar))));
  typedef Integer Indices __attribute__((vector_size(max_k * sizeof(Integer))));

  std::size_t k_;
  Distances distances_;
  Indices indices_;
};

/// A collector that keeps k() <= 8 points, and refuses those not below its bound by itself, without a branch.
template <class Collector>
concept KeepsFew = requires(const Collector& found) {
  { found.k() } -> std::convertible_to<std::size_t>;
  { Collector::offers_are_cheap } -> std::convertible_to<bool>;
  requires Collector::max_k <= 8;
};

template <class Collector>
inline constexpr bool refuses_cheaply = false;
template <KeepsFew Collector>
inline constexpr bool refuses_cheaply<Collector> = Collector::offers_are_cheap;

}  // namespace chainslam::detail
