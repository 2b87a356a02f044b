#pragma once

#include <array>
#include <cstddef>
#include <cstring>
#include <utility>
#include <vector>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/detail/piece_list.hpp"
#include "chainslam/factor_graph/factors.hpp"
#include "chainslam/factor_graph/noise_model.hpp"

namespace chainslam::detail {

/// Matrices of which many are the same, as the noises of one sensor are: each is kept once while it is needed.
template <class Matrix>
class SharedMatrices {
 public:
  /// @returns the number of these bits, which are compared with the last ones that were new.
  [[nodiscard]] Index add(const Matrix& matrix) {
    for (const Index k : newest_) {
      if (k == -1 || at(k).uses == 0 || std::memcmp(at(k).matrix.data(), matrix.data(), bytes) != 0) continue;
      ++at(k).uses;
      return k;
    }
    Index k = kept_.size();
    if (free_.empty()) {
      kept_.add();
    } else {
      k = free_.back();
      free_.pop_back();
    }
    at(k) = {matrix, 1};
    newest_[next_++ % newest_.size()] = k;
    return k;
  }
  void remove(Index k) {
    if (--at(k).uses == 0) free_.push_back(k);
  }
  [[nodiscard]] const Matrix& operator[](Index k) const { return kept_[k].matrix; }
  /// How many different ones are kept, or have been at once.
  [[nodiscard]] Index size() const { return kept_.size(); }

 private:
  static constexpr std::size_t bytes = sizeof(double) * static_cast<std::size_t>(Matrix::SizeAtCompileTime);

  struct Kept {
    Matrix matrix;
    Index uses;
  };

  [[nodiscard]] Kept& at(Index k) { return kept_[k]; }

  PieceList<Kept> kept_;
  Table<Index> free_;
  std::array<Index, 8> newest_{-1, -1, -1, -1, -1, -1, -1, -1};
  std::size_t next_ = 0;
};

/// A factor as a pool keeps it: as it is.
template <class F>
struct PackedFactor {
  struct Shared {};

  PackedFactor() = default;
  PackedFactor(const F& packed, Shared&) : factor(packed) {}
  [[nodiscard]] const F& unpacked(const Shared&) const { return factor; }
  void give_back(Shared&) {}

  F factor{};
};

/// Most factors are between two variables, and most of such a factor is its noise.
template <class Group, class Kernel>
struct PackedFactor<BetweenFactor<Group, Kernel>> {
  using Shared = SharedMatrices<SqrtInformation<Group::dof>>;

  PackedFactor() = default;
  PackedFactor(const BetweenFactor<Group, Kernel>& factor, Shared& shared)
      : from(factor.from),
        to(factor.to),
        information(shared.add(factor.sqrt_information)),
        kernel(factor.kernel),
        measurement(factor.measurement) {}
  [[nodiscard]] BetweenFactor<Group, Kernel> unpacked(const Shared& shared) const {
    return {from, to, measurement, shared[information], kernel};
  }
  void give_back(Shared& shared) { shared.remove(std::exchange(information, -1)); }

  Key from = 0;
  Key to = 0;
  Index information = -1;  ///< number of its square root
  [[no_unique_address]] Kernel kernel{};
  Group measurement{};
};

}  // namespace chainslam::detail
