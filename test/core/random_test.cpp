#include "chainslam/core/random.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <set>
#include <vector>

namespace chainslam {
namespace {

TEST_SUITE("core/random") {
  TEST_CASE("bits are those that xoshiro256++, seeded by splitmix64 of 0, gives in the Rust crate rand 0.8") {
    Rng rng(0);
    for (const std::uint64_t expected : {5987356902031041503U, 7051070477665621255U, 6633766593972829180U,
                                         211316841551650330U, 9136120204379184874U, 379361710973160858U})
      CHECK(rng.bits() == expected);
  }

  TEST_CASE("distributions keep their bits for ever") {
    Rng rng(42);
    std::uint64_t digest = 0;
    for (int i = 0; i < 10'000; ++i) {
      digest = std::rotl(digest, 7) ^ std::bit_cast<std::uint64_t>(rng.normal());
      digest = std::rotl(digest, 7) ^ std::bit_cast<std::uint64_t>(rng.uniform(-3.0, 7.0));
      digest = std::rotl(digest, 7) ^ static_cast<std::uint64_t>(rng.uniform_index(1000));
    }
    CHECK(digest == 16836724399861440221U);
  }

  TEST_CASE("normal draws have the moments and the tails of the normal distribution") {
    constexpr int count = 2'000'000;
    Rng rng(7);
    std::array<double, 5> moments{};
    int beyond_one = 0, beyond_tail = 0;
    for (int i = 0; i < count; ++i) {
      const double x = rng.normal();
      double power = 1.0;
      for (double& moment : moments) moment += (power *= x) / count;
      beyond_one += std::abs(x) > 1.0;
      beyond_tail += std::abs(x) > 3.5;
    }
    // Four standard errors of each mean: the variance of x^k is (2k - 1)!! less the squared mean.
    const double root = 4.0 / std::sqrt(count);
    CHECK(std::abs(moments[0]) < root);
    CHECK(std::abs(moments[1] - 1.0) < root * std::sqrt(2.0));
    CHECK(std::abs(moments[2]) < root * std::sqrt(15.0));
    CHECK(std::abs(moments[3] - 3.0) < root * std::sqrt(96.0));
    CHECK(std::abs(moments[4]) < root * std::sqrt(945.0));
    const double share_one = std::erfc(1.0 / std::sqrt(2.0)), share_tail = std::erfc(3.5 / std::sqrt(2.0));
    CHECK(std::abs(beyond_one / double(count) - share_one) < root * std::sqrt(share_one));
    CHECK(std::abs(beyond_tail / double(count) - share_tail) < root * std::sqrt(share_tail));
  }

  TEST_CASE("normal draws follow the distribution function everywhere (Kolmogorov and Smirnov)") {
    constexpr std::size_t count = 200'000;
    Rng rng(11);
    std::vector<double> draws(count);
    for (double& draw : draws) draw = rng.normal();
    std::ranges::sort(draws);
    double largest = 0.0;
    for (std::size_t i = 0; i < count; ++i) {
      const double expected = 0.5 * std::erfc(-draws[i] / std::sqrt(2.0));
      largest = std::max({largest, std::abs(expected - double(i) / count), std::abs(expected - double(i + 1) / count)});
    }
    CHECK(largest < 1.95 / std::sqrt(double(count)));  // exceeded once in 1000 seeds
  }

  TEST_CASE("uniform draws fill [0, 1) evenly") {
    Rng rng(3);
    std::array<int, 16> bins{};
    for (int i = 0; i < 160'000; ++i) {
      const double x = rng.uniform();
      REQUIRE(x >= 0.0);
      REQUIRE(x < 1.0);
      ++bins[static_cast<std::size_t>(x * 16)];
    }
    double chi_squared = 0.0;
    for (const int bin : bins) chi_squared += (bin - 10'000.0) * (bin - 10'000.0) / 10'000.0;
    CHECK(chi_squared < 37.7);  // 15 degrees of freedom, 0.999
  }

  TEST_CASE("uniform_index hits every value, evenly, and never the count") {
    Rng rng(5);
    std::array<int, 7> bins{};
    for (int i = 0; i < 70'000; ++i) ++bins[static_cast<std::size_t>(rng.uniform_index(7))];
    for (const int bin : bins) CHECK(std::abs(bin - 10'000) < 400);  // four standard deviations
    CHECK(rng.uniform_index(1) == 0);
    constexpr Index largest = std::numeric_limits<Index>::max();
    for (int i = 0; i < 100; ++i) CHECK(rng.uniform_index(largest) < largest);
  }

  TEST_CASE("a fork depends on seed and stream, not on what was drawn") {
    Rng fresh(9), used(9);
    for (int i = 0; i < 5; ++i) used.normal();
    Rng left = fresh.fork(4), right = used.fork(4);
    for (int i = 0; i < 10; ++i) CHECK(left.bits() == right.bits());
  }

  TEST_CASE("streams, seeds and forks of forks are all different and uncorrelated") {
    std::set<std::uint64_t> firsts;
    for (std::uint64_t seed = 0; seed < 50; ++seed) {
      firsts.insert(Rng(seed).bits());
      for (std::uint64_t stream = 0; stream < 50; ++stream) {
        firsts.insert(Rng(seed).fork(stream).bits());
        firsts.insert(Rng(seed).fork(stream).fork(stream).bits());
      }
    }
    CHECK(firsts.size() == 50 * 101);

    constexpr int count = 100'000;
    Rng a = Rng(1).fork(0), b = Rng(1).fork(1);
    double correlation = 0.0;
    for (int i = 0; i < count; ++i) correlation += a.normal() * b.normal() / count;
    CHECK(std::abs(correlation) < 4.0 / std::sqrt(count));
  }

  TEST_CASE("draws work in constant expressions") {
    constexpr std::uint64_t first = [] { return Rng(0).bits(); }();
    static_assert(first == 5987356902031041503U);
    static_assert(Rng(1).fork(2).uniform() < 1.0);
  }
}

}  // namespace
}  // namespace chainslam
