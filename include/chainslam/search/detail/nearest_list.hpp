#pragma once

#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <span>
#include <type_traits>

#include "chainslam/search/concepts.hpp"
#include "chainslam/search/detail/small_nearest.hpp"

namespace chainslam::detail {

/// The smallest value above `value`, which is not negative.
template <class Scalar>
[[nodiscard]] Scalar next_above(Scalar value) {
  using Bits = std::conditional_t<sizeof(Scalar) == 4, std::uint32_t, std::uint64_t>;
  return std::bit_cast<Scalar>(std::bit_cast<Bits>(value) + 1);
}

/// The smallest value above max_distance^2, so that `d < bound` says `d <= max_distance^2`; 0 where nothing is within.
template <class Scalar>
[[nodiscard]] Scalar distance_bound(Scalar max_distance) {
  if (!(max_distance >= 0)) return 0;
  const Scalar squared = max_distance * max_distance;
  if (!(squared < std::numeric_limits<Scalar>::infinity())) return std::numeric_limits<Scalar>::infinity();
  return next_above(squared);
}

/// Collects the nearest points, ascending, in the caller's memory. Points with d < bound() are worth offering.
template <class Scalar>
class NearestList {
 public:
  NearestList(std::span<Neighbor<Scalar>> out, Scalar bound)
      : out_(out.data()), capacity_(to_index(out.size(), "k")), bound_(out.empty() ? 0 : bound) {}

  [[nodiscard]] Scalar bound() const { return bound_; }
  [[nodiscard]] Index size() const { return size_; }
  [[nodiscard]] bool full() const { return size_ == capacity_; }

  void offer(Index index, Scalar squared_distance) {
    Index i = size_ < capacity_ ? size_++ : capacity_ - 1;
    for (; i > 0 && out_[i - 1].squared_distance > squared_distance; --i) out_[i] = out_[i - 1];
    out_[i] = {index, squared_distance};
    if (full()) bound_ = out_[size_ - 1].squared_distance;
  }

 private:
  Neighbor<Scalar>* out_;
  Index capacity_;
  Index size_ = 0;
  Scalar bound_;
};

/// The K nearest, K known to the compiler.
template <class Scalar, int K>
class FixedNearestList : public SmallNearest<Scalar> {
 public:
  explicit FixedNearestList(Scalar bound) : SmallNearest<Scalar>(K, bound) {}

  [[nodiscard]] KNearest<Scalar, K> result() const {
    KNearest<Scalar, K> found;
    found.count = this->write({found.neighbors.data(), found.neighbors.size()});
    return found;
  }
};

template <class Scalar, int K>
  requires(K > SmallNearest<Scalar>::max_k)
class FixedNearestList<Scalar, K> : private KNearest<Scalar, K>, public NearestList<Scalar> {
 public:
  explicit FixedNearestList(Scalar bound)
      : NearestList<Scalar>({this->neighbors.data(), this->neighbors.size()}, bound) {}
  FixedNearestList(const FixedNearestList&) = delete;
  FixedNearestList& operator=(const FixedNearestList&) = delete;
  ~FixedNearestList() = default;

  [[nodiscard]] KNearest<Scalar, K> result() {
    this->count = this->size();
    return *this;
  }
};

}  // namespace chainslam::detail
