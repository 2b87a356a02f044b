#include <doctest/doctest.h>

#include <limits>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/sparse/cholesky.hpp"
#include "sparse/patterns.hpp"
#include "support/property.hpp"
#include "support/threads_cases.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

/// A square of nodes, each tied to the next ones: its fronts grow towards the root.
BlockPattern square_lattice(Index side) {
  std::vector<BlockCoordinate> blocks;
  for (Index k = 0; k < side * side; ++k) {
    if (k % side > 0) blocks.push_back({k, k - 1});
    if (k >= side) blocks.push_back({k, k - side});
  }
  return BlockPattern(side * side, blocks);
}

}  // namespace

TEST_SUITE("sparse/parallel_cholesky") {
  THREADS_TEST_CASE("sparse/parallel_cholesky",
                    "any number of threads gives the bits of one, and names the same bad column") {
    const ThreadPool one(1), two(2), eight(8);
    for_all(12, [&](Rng& rng, int size) {
      const BlockPattern pattern =
          size % 3 == 0 ? square_lattice(2 + size) : random_pattern(rng, 20 * size, rng.uniform(0.0, 0.3));
      const BlockMatrix<3> matrix = random_normal_equations<3>(pattern, rng, 0.1);
      const Eigen::VectorXd b = random_vector(rng, pattern.size() * 3);
      const std::vector<double> damping(static_cast<std::size_t>(pattern.size()) * 3, 0.01);
      BlockMatrix<3> spoilt = matrix;
      for (int k = 0; k < 3; ++k)
        spoilt.block(pattern.begin(rng.uniform_index(pattern.size())))(1, 1) = k == 0 ? -1e9 : -1.0;
      BlockCholesky<3> serial;
      serial.analyze(pattern);
      const FactorizationResult bad = serial.factorize(spoilt);
      CHECK(!bad.ok());
      REQUIRE(serial.factorize(matrix, damping).ok());
      const Eigen::VectorXd expected = solved(serial, b);
      for (const ThreadPool* const pool : {&one, &two, &eight}) {
        ParallelCholesky<3, ThreadPool> parallel(*pool);
        parallel.analyze(pattern);
        CHECK(parallel.factorize(spoilt).block_column == bad.block_column);
        REQUIRE(parallel.factorize(matrix, damping).ok());
        CHECK(solved(parallel, b) == expected);
        REQUIRE(serial.factorize(matrix, damping, *pool).ok());
        CHECK(solved(serial, b) == expected);
        REQUIRE(serial.factorize(matrix, damping).ok());
        CHECK(solved(serial, b) == expected);
      }
    });
  }

  TEST_CASE("what is empty or one block is factorized in parallel, too") {
    const ThreadPool pool(2);
    ParallelCholesky<6, ThreadPool> solver(pool);
    solver.analyze(BlockPattern());
    CHECK(solver.factorize(BlockMatrix<6>()).ok());
    Rng rng(1);
    const BlockMatrix<6> matrix = random_normal_equations<6>(BlockPattern(1, {}), rng, 1.0);
    solver.analyze(matrix.pattern());
    CHECK(solver.factorize(matrix).ok());
    CHECK(solver.factorize(matrix).ok());
    const Eigen::VectorXd b = random_vector(rng, 6);
    CHECK((matrix * solved(solver, b)).isApprox(b, 1e-9));
  }
}
