#include "chainslam/sparse/detail/elimination_tree.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <vector>

#include "sparse/patterns.hpp"
#include "support/property.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

/// The factor's pattern by the definition: eliminating a column joins all rows below its diagonal.
std::vector<std::vector<bool>> eliminate_by_definition(const BlockPattern& pattern) {
  const auto size = static_cast<std::size_t>(pattern.size());
  std::vector<std::vector<bool>> filled(size, std::vector<bool>(size, false));
  for (std::size_t j = 0; j < size; ++j) {
    for (const Index i : pattern.rows(static_cast<Index>(j))) filled[static_cast<std::size_t>(i)][j] = true;
  }
  for (std::size_t j = 0; j < size; ++j) {
    for (std::size_t a = j + 1; a < size; ++a) {
      for (std::size_t b = a; b < size; ++b) {
        if (filled[a][j] && filled[b][j]) filled[b][a] = true;
      }
    }
  }
  return filled;
}

}  // namespace

TEST_SUITE("sparse/elimination_tree") {
  TEST_CASE("tree and column counts agree with elimination by the definition") {
    for_all(60, [](Rng& rng, int size) {
      const BlockPattern pattern = random_pattern(rng, size, rng.uniform(0.0, 1.5));
      const std::vector<Index> parents = detail::elimination_tree(pattern);
      const std::vector<Index> counts = detail::factor_column_counts(pattern, parents);
      const auto filled = eliminate_by_definition(pattern);
      for (std::size_t j = 0; j < filled.size(); ++j) {
        Index parent = -1;
        Index count = 0;
        for (std::size_t i = filled.size(); i-- > j;) {
          if (!filled[i][j]) continue;
          ++count;
          if (i > j) parent = static_cast<Index>(i);
        }
        CHECK(parents[j] == parent);
        CHECK(counts[j] == count);
      }
    });
  }

  TEST_CASE("a postorder visits each subtree in one piece, the heaviest child last") {
    for_all(40, [](Rng& rng, int size) {
      const BlockPattern pattern = random_pattern(rng, size, 0.5);
      const std::vector<Index> parents = detail::elimination_tree(pattern);
      const std::vector<Index> weights = detail::factor_column_counts(pattern, parents);
      const std::vector<Index> order = detail::postorder(parents, weights);
      std::vector<Index> place(order.size(), -1);
      for (std::size_t k = 0; k < order.size(); ++k) place[static_cast<std::size_t>(order[k])] = static_cast<Index>(k);
      REQUIRE(std::ranges::count(place, -1) == 0);
      std::vector<Index> subtree(order.size(), 1);
      std::vector<Index> heaviest(order.size(), 0);
      for (const Index column : order) {
        const Index parent = parents[static_cast<std::size_t>(column)];
        if (parent == -1) continue;
        const auto p = static_cast<std::size_t>(parent);
        subtree[p] += subtree[static_cast<std::size_t>(column)];
        CHECK(weights[static_cast<std::size_t>(column)] >= heaviest[p]);
        heaviest[p] = weights[static_cast<std::size_t>(column)];
      }
      for (const Index column : order) {  // the whole subtree lies just before its root
        const Index parent = parents[static_cast<std::size_t>(column)];
        if (parent == -1) continue;
        const Index first = place[static_cast<std::size_t>(parent)] - subtree[static_cast<std::size_t>(parent)] + 1;
        CHECK(place[static_cast<std::size_t>(column)] >= first);
        CHECK(place[static_cast<std::size_t>(column)] < place[static_cast<std::size_t>(parent)]);
      }
    });
  }

  TEST_CASE("a chain of a million columns overflows nothing") {
    std::vector<BlockCoordinate> blocks;
    for (Index k = 1; k < 1'000'000; ++k) blocks.push_back({k, k - 1});
    const BlockPattern chain(1'000'000, blocks);
    const std::vector<Index> parents = detail::elimination_tree(chain);
    CHECK(parents[0] == 1);
    CHECK(parents[999'999] == -1);
    const std::vector<Index> order = detail::postorder(parents, detail::factor_column_counts(chain, parents));
    CHECK(std::ranges::is_sorted(order));
  }

  TEST_CASE("nothing has an empty tree") {
    CHECK(detail::elimination_tree(BlockPattern()).empty());
    CHECK(detail::postorder({}, {}).empty());
  }
}
