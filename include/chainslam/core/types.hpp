#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <bit>
#include <compare>
#include <concepts>
#include <cstdint>
#include <limits>
#include <span>
#include <stdexcept>
#include <string>
#include <utility>

namespace chainslam {

/// Counts and positions inside the library. Sizes come in as `std::size_t` and are checked once, at the door, by
/// `to_index`.
using Index = std::int32_t;

namespace detail {

/// Apart, so that each place that narrows a size does not carry the message's making.
[[noreturn]] [[gnu::cold]] [[gnu::noinline]] inline void refuse_size(const char* what) {
  throw std::invalid_argument(std::string(what).append(" exceeds 2^31 - 1"));
}

}  // namespace detail

/// Narrows a size to `Index`.
/// @throws std::invalid_argument if it does not fit; `what` names the thing that was too large.
template <std::integral Size>
[[nodiscard]] constexpr Index to_index(Size size, const char* what = "size") {
  if (!std::in_range<Index>(size)) detail::refuse_size(what);
  return static_cast<Index>(size);
}

using Vector6d = Eigen::Matrix<double, 6, 1>;
using Matrix6d = Eigen::Matrix<double, 6, 6>;

/// Square root R of an information matrix, R^T R = information, as stored in factors, maps and files: its layout
/// depends on no compiler flag. Directions without information are allowed.
template <int Dof>
using SqrtInformation = Eigen::Matrix<double, Dof, Dof, Eigen::DontAlign>;

/// An index that knows what it counts, so that a session's number is never taken for a keyframe's.
template <class Tag>
struct Id {
  Index value = -1;  ///< position in the list that it numbers; -1: none

  [[nodiscard]] constexpr bool valid() const { return value >= 0; }  ///< whether it stands for anything
  friend constexpr auto operator<=>(Id, Id) = default;               ///< orders by value
};

/// Keyframes are numbered through all sessions of a map, in the order in which they were added, from 0.
using KeyframeId = Id<struct KeyframeTag>;
/// Sessions of a map are numbered in the order in which they were added, from 0.
using SessionId = Id<struct SessionTag>;

/// True for numbers, false for NaN and infinities. Reads the exponent's bits: under `-ffast-math` a compiler takes
/// `std::isfinite` to be true always.
[[nodiscard]] constexpr bool is_finite(float value) {
  constexpr std::uint32_t exponent = 0x7f80'0000;
  return (std::bit_cast<std::uint32_t>(value) & exponent) != exponent;
}

/// @copydoc is_finite(float)
[[nodiscard]] constexpr bool is_finite(double value) {
  constexpr std::uint64_t exponent = 0x7ff0'0000'0000'0000;
  return (std::bit_cast<std::uint64_t>(value) & exponent) != exponent;
}

/// True if all coefficients are finite.
template <class Derived>
  requires std::same_as<typename Derived::Scalar, float> || std::same_as<typename Derived::Scalar, double>
[[nodiscard]] bool is_finite(const Eigen::DenseBase<Derived>& coefficients) {
  for (Eigen::Index column = 0; column < coefficients.cols(); ++column)
    for (Eigen::Index row = 0; row < coefficients.rows(); ++row)
      if (!is_finite(coefficients.derived().coeff(row, column))) return false;
  return true;
}

/// A thing by its number, and what it is sorted by.
struct Ranked {
  double rank = 0;  ///< what it is sorted by
  Index index = 0;  ///< what it stands for

  /// By rank, then by index.
  [[nodiscard]] bool operator<(const Ranked& other) const {
    return rank != other.rank ? rank < other.rank : index < other.index;
  }
};

/// The least rank first, equal ones by index. Whatever is sorted, the sort is compiled once.
[[gnu::noinline]] inline void sort_ranked(std::span<Ranked> all) { std::sort(all.data(), all.data() + all.size()); }

}  // namespace chainslam
