#include "chainslam/search/hamming_forest.hpp"

#include <doctest/doctest.h>

#include <vector>

#include "support/property.hpp"

namespace chainslam {
namespace {

using test::for_all;

BinaryDescriptor random_bits(Rng& rng) { return {rng.bits(), rng.bits(), rng.bits(), rng.bits()}; }

BinaryDescriptor flipped(BinaryDescriptor descriptor, Index bits, Rng& rng) {
  for (Index k = 0; k < bits; ++k) {
    const Index bit = rng.uniform_index(256);
    descriptor[static_cast<std::size_t>(bit / 64)] ^= std::uint64_t{1} << (bit % 64);
  }
  return descriptor;
}

/// Share of descriptors that are found again with so many bits changed.
double found_again(Index bits, const HammingForestOptions& options, std::size_t count) {
  Rng rng(7);
  HammingForest forest(options);
  for (std::size_t i = 0; i < count; ++i) forest.insert(random_bits(rng));
  std::vector<HammingForest::Found> near;
  int found = 0;
  for (Index i = 0; i < 500; ++i) {
    forest.near(flipped(forest.descriptor(i), bits, rng), 55, near);
    for (const HammingForest::Found& one : near) found += one.id == i ? 1 : 0;
  }
  return found / 500.0;
}

}  // namespace

TEST_SUITE("search/hamming_forest") {
  TEST_CASE("distances count bits, and are exact up to a limit unless they lie in one word") {
    for_all(50, [](Rng& rng, int) {
      const BinaryDescriptor a = random_bits(rng), b = flipped(a, rng.uniform_index(100), rng);
      Index count = 0;
      for (std::size_t bit = 0; bit < 256; ++bit) count += ((a[bit / 64] ^ b[bit / 64]) >> (bit % 64)) & 1U ? 1 : 0;
      CHECK(hamming_distance(a, b) == count);
      const Index within = hamming_distance_within(a, b, 70);
      CHECK((within == count || within > 70));
    });
  }

  TEST_CASE("what is found is what brute force finds, but for some that it misses; the same one is always found") {
    for_all(20, [](Rng& rng, int size) {
      HammingForest forest;
      std::vector<BinaryDescriptor> all;
      for (int i = 0; i < 20 * size + 1; ++i) {
        all.push_back(i % 3 == 2 ? flipped(all[all.size() - 2], 20, rng) : random_bits(rng));
        CHECK(forest.insert(all.back()) == i);
      }
      std::vector<HammingForest::Found> near;
      for (std::size_t i = 0; i < all.size(); ++i) {
        forest.near(all[i], 55, near);
        bool itself = false;
        for (std::size_t k = 0; k < near.size(); ++k) {
          CHECK(near[k].distance == hamming_distance(all[i], all[static_cast<std::size_t>(near[k].id)]));
          CHECK(near[k].distance <= 55);
          CHECK((k == 0 || near[k - 1].id < near[k].id));
          itself = itself || near[k].id == static_cast<Index>(i);
        }
        CHECK(itself);
      }
    });
  }

  TEST_CASE("queries together find what each finds alone") {
    for_all(20, [](Rng& rng, int size) {
      HammingForest forest({.trees = 3, .leaf_size = 8});
      std::vector<BinaryDescriptor> queries;
      for (int i = 0; i < 50 * size; ++i) {
        const BinaryDescriptor one = random_bits(rng);
        forest.insert(one);
        if (i % 5 == 0) queries.push_back(flipped(one, 15, rng));
      }
      std::vector<HammingForest::Found> together, alone;
      forest.near_each(queries, 100, together);
      std::size_t at = 0;
      for (std::size_t q = 0; q < queries.size(); ++q) {
        forest.near(queries[q], 100, alone);
        for (const HammingForest::Found& one : alone) {
          REQUIRE(at < together.size());
          CHECK(together[at].query == static_cast<Index>(q));
          CHECK(together[at].id == one.id);
          CHECK(together[at].distance == one.distance);
          ++at;
        }
      }
      CHECK(at == together.size());
    });
  }

  TEST_CASE("a forest finds as many again as its depth says, more trees find more") {
    // 2^14 random descriptors in leaves of 16 to 32 lie at depth 9 to 10. With 30 of 256 bits changed (28.3 different
    // ones on average) two meet in one of 6 leaves with probability 1 - (1 - 0.89^9.5)^6 = 0.91; in one tree 0.33.
    const double six = found_again(30, {}, 1 << 14);
    CHECK(six > 0.85);
    CHECK(six < 0.97);
    CHECK(found_again(30, {.trees = 1}, 1 << 14) == doctest::Approx(0.33).epsilon(0.25));
    CHECK(found_again(30, {.trees = 16}, 1 << 14) > 0.97);
  }

  TEST_CASE("descriptors that no bit parts do not make a query slow: some of them are forgotten") {
    HammingForest forest;
    for (int i = 0; i < 10000; ++i) forest.insert({1, 2, 3, 4});
    std::vector<HammingForest::Found> near;
    forest.near({1, 2, 3, 4}, 0, near);
    CHECK(near.size() == 128);  // the same ones in all trees
  }

  TEST_CASE("an empty forest finds nothing, options that make no sense are refused") {
    std::vector<HammingForest::Found> near{{1, 1}};
    HammingForest().near({}, 256, near);
    CHECK(near.empty());
    CHECK_THROWS_AS(HammingForest({.trees = 0}), std::invalid_argument);
    CHECK_THROWS_AS(HammingForest({.leaf_size = 0}), std::invalid_argument);
    CHECK_THROWS_AS(HammingForest({.leaf_size = 200}), std::invalid_argument);
  }
}

}  // namespace chainslam
