#include "chainslam/sparse/cholesky.hpp"

#include <doctest/doctest.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "chainslam/sparse/cholmod.hpp"
#include "sparse/patterns.hpp"
#include "support/property.hpp"
#include "support/real_data.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

struct NoSolver {
  static constexpr int block_size = 3;
  void analyze(const BlockPattern&) {}
};
static_assert(!LinearSolver<NoSolver>);
static_assert(LinearSolver<BlockCholesky<1, Natural>> && LinearSolver<Cholmod<3>>);

using NaturalCholesky = BlockCholesky<3, Natural>;

BlockMatrix<1> chain(Index size) {
  std::vector<BlockCoordinate> blocks;
  for (Index k = 1; k < size; ++k) blocks.push_back({k, k - 1});
  BlockMatrix<1> matrix{BlockPattern(size, blocks)};
  for (Index column = 0; column < size; ++column) {
    *matrix.data(matrix.pattern().begin(column)) = 2.5;
    if (column + 1 < size) *matrix.data(matrix.pattern().begin(column) + 1) = -1.0;
  }
  return matrix;
}

/// |A x - b| relative to |A| |x|, which is what a backward stable solver keeps near the machine's precision.
template <int N>
double residual(const BlockMatrix<N>& matrix, const Eigen::VectorXd& x, const Eigen::VectorXd& b) {
  double largest = 0.0;
  for (Offset k = 0; k < matrix.pattern().blocks(); ++k) largest = std::max(largest, matrix.block(k).norm());
  return (matrix * x - b).norm() / (largest * x.norm() + b.norm());
}

}  // namespace

TEST_SUITE("sparse/cholesky") {
  TEST_CASE_TEMPLATE("solutions agree with the dense factorization", Solver, BlockCholesky<1>, BlockCholesky<3>,
                     BlockCholesky<6>, NaturalCholesky, Cholmod<3>) {
    constexpr int N = Solver::block_size;
    for_all(40, [](Rng& rng, int size) {
      const BlockPattern pattern = random_pattern(rng, size, rng.uniform(0.0, 2.0));
      const BlockMatrix<N> matrix = random_normal_equations<N>(pattern, rng, 0.1);
      const Eigen::VectorXd b = random_vector(rng, size * N);
      Solver solver;
      solver.analyze(pattern);
      REQUIRE(solver.factorize(matrix).ok());
      // condition numbers stay below 1e5 with a unary factor of 0.1 everywhere
      CHECK(solved(solver, b).isApprox(dense(matrix).llt().solve(b), 1e-9));
    });
  }

  TEST_CASE_TEMPLATE("the inverse's diagonal blocks are those of the dense inverse", Solver, BlockCholesky<1>,
                     BlockCholesky<6>, NaturalCholesky) {
    for_all(30, [](Rng& rng, int size) {
      constexpr int N = Solver::block_size;
      const BlockPattern pattern = random_pattern(rng, size, rng.uniform(0.0, 2.0));
      const BlockMatrix<N> matrix = random_normal_equations<N>(pattern, rng, 0.1);
      Solver solver;
      solver.analyze(pattern);
      REQUIRE(solver.factorize(matrix).ok());
      std::vector<double> found(static_cast<std::size_t>(size * N * N));
      solver.inverse_diagonal(found);
      const Eigen::MatrixXd inverse = dense(matrix).llt().solve(Eigen::MatrixXd::Identity(size * N, size * N));
      for (Index k = 0; k < size; ++k) {
        const Eigen::MatrixXd expected = inverse.block(k * N, k * N, N, N);
        CHECK(Eigen::Map<const Eigen::MatrixXd>(found.data() + k * N * N, N, N).isApprox(expected, 1e-9));
      }
    });
  }

  TEST_CASE("damping adds to the diagonal, and the next factorization does without it") {
    Rng rng(1);
    const BlockMatrix<6> matrix = random_normal_equations<6>(random_pattern(rng, 50, 1.0), rng, 0.1);
    const Eigen::VectorXd b = random_vector(rng, 300);
    const std::vector<double> damping = [&] {
      std::vector<double> values(300);
      for (double& value : values) value = rng.uniform(0.0, 10.0);
      return values;
    }();
    BlockCholesky<6> solver;
    solver.analyze(matrix.pattern());
    REQUIRE(solver.factorize(matrix, damping).ok());
    Eigen::MatrixXd damped = dense(matrix);
    damped.diagonal() += Eigen::Map<const Eigen::VectorXd>(damping.data(), 300);
    CHECK(solved(solver, b).isApprox(damped.llt().solve(b), 1e-10));
    REQUIRE(solver.factorize(matrix).ok());
    CHECK(solved(solver, b).isApprox(dense(matrix).llt().solve(b), 1e-9));
  }

  TEST_CASE("the same values give the same bits, also after others") {
    Rng rng(2);
    const BlockPattern pattern = random_pattern(rng, 200, 1.0);
    const BlockMatrix<3> first = random_normal_equations<3>(pattern, rng, 0.1);
    const BlockMatrix<3> second = random_normal_equations<3>(pattern, rng, 0.1);
    const Eigen::VectorXd b = random_vector(rng, 600);
    BlockCholesky<3> solver;
    solver.analyze(pattern);
    REQUIRE(solver.factorize(first).ok());
    const Eigen::VectorXd x = solved(solver, b);
    REQUIRE(solver.factorize(second).ok());
    REQUIRE(solver.factorize(first).ok());
    CHECK(solved(solver, b) == x);
  }

  TEST_CASE("an indefinite matrix is named by its block column, and the solver goes on") {
    for_all(30, [](Rng& rng, int size) {
      const BlockPattern pattern(size, {});
      BlockMatrix<3> matrix = random_normal_equations<3>(pattern, rng, 1.0);
      const Index bad = rng.uniform_index(size);
      BlockCholesky<3> solver;
      solver.analyze(pattern);
      for (const double value :
           {-1.0, 0.0, std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
        BlockMatrix<3> spoilt = matrix;
        spoilt.block(pattern.begin(bad))(1, 1) = value;
        const FactorizationResult result = solver.factorize(spoilt);
        CHECK(result.status == FactorizationStatus::not_positive_definite);
        CHECK(result.block_column == bad);
      }
      CHECK(solver.factorize(matrix).ok());
    });
  }

  TEST_CASE("a matrix with a free direction is singular, not solved") {
    // Differences only: adding a constant to all unknowns changes nothing.
    for_all(50, [](Rng& rng, int size) {
      const Index n = size + 2;
      std::vector<BlockCoordinate> blocks;
      for (Index k = 1; k < n; ++k) blocks.push_back({k, rng.uniform_index(k)});
      BlockMatrix<1> matrix{BlockPattern(n, blocks)};
      const BlockPattern& pattern = matrix.pattern();
      for (Index column = 0; column < n; ++column) {
        for (Offset k = pattern.begin(column) + 1; k < pattern.end(column); ++k) {
          *matrix.data(k) = -1.0;
          *matrix.data(pattern.begin(column)) += 1.0;
          *matrix.data(pattern.begin(pattern.row(k))) += 1.0;
        }
      }
      BlockCholesky<1> solver;
      solver.analyze(pattern);
      CHECK(!solver.factorize(matrix).ok());
    });
  }

  TEST_CASE("the scale of the variables does not make a matrix singular") {
    Rng rng(3);
    const BlockMatrix<3> matrix = random_normal_equations<3>(random_pattern(rng, 40, 1.0), rng, 0.1);
    BlockMatrix<3> scaled = matrix;
    for (Index column = 0; column < 40; ++column) {
      for (Offset k = matrix.pattern().begin(column); k < matrix.pattern().end(column); ++k)
        scaled.block(k) *= std::ldexp(1.0, 40 * (column % 2) + 40 * (matrix.pattern().row(k) % 2));
    }
    BlockCholesky<3> solver;
    solver.analyze(matrix.pattern());
    CHECK(solver.factorize(scaled).ok());
  }

  TEST_CASE("an empty matrix is factorized and solved") {
    BlockCholesky<6> solver;
    solver.analyze(BlockPattern());
    CHECK(solver.factorize(BlockMatrix<6>()).ok());
    solver.solve({});
  }

  TEST_CASE_TEMPLATE("a chain of a million blocks takes linear time and no stack", Order, Natural, Amd) {
    const auto seconds = [](Index size) {
      const BlockMatrix<1> matrix = chain(size);
      const auto start = std::chrono::steady_clock::now();
      BlockCholesky<1, Order> solver;
      solver.analyze(matrix.pattern());
      REQUIRE(solver.factorize(matrix).ok());
      Eigen::VectorXd b = Eigen::VectorXd::Constant(size, 0.5);
      b[0] = b[size - 1] = 1.5;  // the solution is 1 everywhere
      CHECK((solved(solver, b).array() - 1.0).abs().maxCoeff() < 1e-14);
      return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    };
    const double tenth = seconds(100'000);
    CHECK(seconds(1'000'000) < 60.0 * tenth);  // ten times is linear; the rest is for caches and other work
  }

  TEST_CASE("solutions on real pose graphs agree with CHOLMOD's") {
    for (const char* name : {"sphere2500", "parking-garage", "ms5x2000"}) {
      const auto path = real_data(std::string("pose_graphs/") + name + ".g2o");
      if (!path) continue;
      const BlockPattern pattern = pose_graph_pattern(*path);
      Rng rng(4);
      const BlockMatrix<6> matrix = random_normal_equations<6>(pattern, rng, 1e-3);
      const Eigen::VectorXd b = random_vector(rng, pattern.size() * 6);
      BlockCholesky<6> solver;
      Cholmod<6> peer;
      solver.analyze(pattern);
      peer.analyze(pattern);
      REQUIRE(solver.factorize(matrix).ok());
      REQUIRE(peer.factorize(matrix).ok());
      const Eigen::VectorXd x = solved(solver, b);
      const Eigen::VectorXd y = solved(peer, b);
      CHECK(residual(matrix, x, b) < 1e-14);
      CHECK((x - y).norm() < 1e-10 * y.norm());  // condition numbers stay below 1e6
    }
  }
}
