#pragma once

#include <array>
#include <bit>
#include <cassert>
#include <cmath>
#include <cstdint>

#include "chainslam/core/detail/ziggurat.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam {

/// Random numbers that are the same for the same seed on every platform, compiler and C library, which the
/// distributions of `<random>` are not.
///
/// The generator is xoshiro256++ (Blackman and Vigna 2021), seeded through splitmix64 (Steele, Lea and Flood 2014).
/// A generator is small: pass it by reference where draws follow one another, `fork` it where work is split.
class Rng {
 public:
  /// Draws depend on the seed alone.
  explicit constexpr Rng(std::uint64_t seed = 0) : seed_(seed) {
    std::uint64_t counter = seed;
    for (std::uint64_t& word : state_) word = mix(counter += golden_gamma);
  }

  /// An independent generator for one part of the work. Depends on this generator's seed and on `stream`, not on what
  /// has been drawn so far: part 7 sees the same numbers whoever runs it, and whenever.
  [[nodiscard]] constexpr Rng fork(std::uint64_t stream) const {
    return Rng(mix(mix(seed_ + golden_gamma) ^ (stream * golden_gamma + 1)));
  }

  /// 64 random bits.
  constexpr std::uint64_t bits() {
    const std::uint64_t result = std::rotl(state_[0] + state_[3], 23) + state_[0];
    const std::uint64_t shifted = state_[1] << 17;
    state_[2] ^= state_[0];
    state_[3] ^= state_[1];
    state_[1] ^= state_[2];
    state_[0] ^= state_[3];
    state_[2] ^= shifted;
    state_[3] = std::rotl(state_[3], 45);
    return result;
  }

  /// Uniform in [0, 1): a multiple of 2^-53.
  constexpr double uniform() { return static_cast<double>(bits() >> 11) * 0x1p-53; }

  /// Uniform in [low, high]; `high` itself only by rounding.
  double uniform(double low, double high) { return std::fma(high - low, uniform(), low); }

  /// Uniform in {0, ..., count - 1}, without bias (Lemire 2019, algorithm 5).
  constexpr Index uniform_index(Index count) {
    assert(count > 0);
    const auto range = static_cast<std::uint32_t>(count);
    std::uint64_t product = (bits() >> 32) * range;
    if (static_cast<std::uint32_t>(product) < range) {
      const std::uint32_t threshold = (0U - range) % range;
      while (static_cast<std::uint32_t>(product) < threshold) product = (bits() >> 32) * range;
    }
    return static_cast<Index>(product >> 32);
  }

  /// Normal with mean 0 and standard deviation 1, by the ziggurat (Marsaglia and Tsang 2000).
  double normal() {
    using Table = detail::Ziggurat;
    for (;;) {
      const std::uint64_t random = bits();
      const std::size_t layer = random % Table::layers;
      const double sign = (random & Table::layers) != 0 ? 1.0 : -1.0;
      const double x = static_cast<double>(random >> 11) * 0x1p-53 * Table::edges[layer];
      if (x < Table::edges[layer + 1]) return sign * x;  // inside the next layer's edge: under the curve for sure
      if (layer == 0) return sign * normal_tail();
      const double height =
          std::fma(uniform(), Table::densities[layer + 1] - Table::densities[layer], Table::densities[layer]);
      if (height < std::exp(-0.5 * x * x)) return sign * x;
    }
  }

  /// Normal with the given mean and standard deviation.
  double normal(double mean, double standard_deviation) { return std::fma(standard_deviation, normal(), mean); }

 private:
  static constexpr std::uint64_t golden_gamma = 0x9e3779b97f4a7c15;

  static constexpr std::uint64_t mix(std::uint64_t word) {
    word = (word ^ (word >> 30)) * 0xbf58476d1ce4e5b9;
    word = (word ^ (word >> 27)) * 0x94d049bb133111eb;
    return word ^ (word >> 31);
  }

  /// A normal draw beyond the last edge (Marsaglia 1964), from two exponential ones.
  double normal_tail() {
    for (;;) {
      const double beyond = exponential() / detail::Ziggurat::tail_start;
      if (2.0 * exponential() > beyond * beyond) return detail::Ziggurat::tail_start + beyond;
    }
  }

  /// Exponential with mean 1, by comparisons alone (von Neumann 1951), so that no library's logarithm has a say.
  double exponential() {
    for (double whole = 0.0;; whole += 1.0) {
      const double first = uniform();
      double previous = first;
      bool run_is_odd = true;
      for (double next = uniform(); next < previous; next = uniform()) {
        previous = next;
        run_is_odd = !run_is_odd;
      }
      if (run_is_odd) return whole + first;
    }
  }

  std::uint64_t seed_;
  std::array<std::uint64_t, 4> state_{};
};

}  // namespace chainslam
