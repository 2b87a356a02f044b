#include "chainslam/sparse/block_matrix.hpp"

#include <doctest/doctest.h>

#include <set>
#include <stdexcept>
#include <utility>
#include <vector>

#include "sparse/patterns.hpp"
#include "support/property.hpp"

using namespace chainslam;
using namespace chainslam::test;

TEST_SUITE("sparse/block_matrix") {
  TEST_CASE("a pattern is the set of its blocks in the lower triangle, with the diagonal") {
    for_all(50, [](Rng& rng, int size) {
      std::vector<BlockCoordinate> blocks;
      std::set<std::pair<Index, Index>> expected;
      for (Index k = 0; k < size; ++k) expected.insert({k, k});
      for (int k = 0; k < 3 * size; ++k) {
        const BlockCoordinate block{rng.uniform_index(size), rng.uniform_index(size)};
        blocks.push_back(block);
        expected.insert({std::min(block.row, block.column), std::max(block.row, block.column)});
      }
      const BlockPattern pattern(size, blocks);
      std::vector<std::pair<Index, Index>> found;
      for (Index column = 0; column < pattern.size(); ++column) {
        for (const Index row : pattern.rows(column)) {
          found.push_back({column, row});
          CHECK(pattern.row(*pattern.find(row, column)) == row);
        }
      }
      CHECK(found == std::vector<std::pair<Index, Index>>(expected.begin(), expected.end()));
      CHECK(pattern.blocks() == static_cast<Offset>(expected.size()));
    });
  }

  TEST_CASE("a block that is not in the pattern is not found") {
    const BlockPattern pattern(3, std::vector<BlockCoordinate>{{2, 0}});
    CHECK(pattern.find(2, 0).has_value());
    CHECK(!pattern.find(1, 0).has_value());
    CHECK(!pattern.find(2, 1).has_value());
  }

  TEST_CASE("blocks outside the matrix are refused") {
    CHECK_THROWS_AS(BlockPattern(2, std::vector<BlockCoordinate>{{2, 0}}), std::invalid_argument);
    CHECK_THROWS_AS(BlockPattern(2, std::vector<BlockCoordinate>{{0, -1}}), std::invalid_argument);
    CHECK_THROWS_AS(BlockPattern(-1, {}), std::invalid_argument);
  }

  TEST_CASE("the empty pattern has no blocks") {
    CHECK(BlockPattern().blocks() == 0);
    CHECK(BlockPattern(0, {}).size() == 0);
    CHECK(BlockMatrix<6>().size() == 0);
  }

  TEST_CASE("the product with a vector is that of the dense matrix") {
    for_all(20, [](Rng& rng, int size) {
      const BlockMatrix<3> matrix = random_normal_equations<3>(random_pattern(rng, size, 1.5), rng);
      const Eigen::VectorXd x = random_vector(rng, size * 3);
      CHECK((matrix * x).isApprox(dense(matrix) * x, 1e-13));
    });
  }
}
