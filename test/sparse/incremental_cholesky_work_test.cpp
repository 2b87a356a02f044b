#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "chainslam/sparse/incremental_cholesky.hpp"
#include "support/quick.hpp"
#include "support/street_walk.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

using StreetSolver = IncrementalCholesky<6>;

/// A term that ties two variables together, or one to a point.
void tie(StreetSolver& solver, std::span<const Index> variables) {
  const Index term = solver.add_term(variables, 6);
  double* jacobian = solver.jacobian(term);
  for (int row = 0; row < 6; ++row) {
    for (std::size_t k = 0; k < variables.size(); ++k) {
      for (int column = 0; column < 6; ++column) *jacobian++ = column != row ? 0.0 : k == 0 ? 1.0 : -1.0;
    }
  }
  std::fill_n(solver.residual(term), 6, 1.0);
}

/// Adds a variable with the terms of a step.
void take(StreetSolver& solver, const StreetWalk::Step& step) {
  const Index newest = solver.size();
  solver.begin();
  solver.add_variable();
  if (step.starts)
    tie(solver, std::array{newest});
  else
    tie(solver, std::array{newest - 1, newest});
  for (const StreetWalk::Closure& closure : step.closures) tie(solver, std::array{closure.from, newest});
  REQUIRE(solver.factorize().ok());
  solver.solve();
}

/// Multiplications of the second half of a walk, a variable each step.
double late_work(const StreetWalkOptions& town, const StreetSolver::Options& options) {
  StreetWalk walk(town);
  StreetSolver solver(options);
  double work = 0.0;
  while (!walk.done()) {
    const Index newest = solver.size();
    take(solver, walk.next());
    if (newest >= town.sessions * town.keyframes / 2) work += solver.work().multiplications;
    solver.reset_work();
  }
  return work;
}

/// What `save` writes, loaded.
StreetSolver copy_of(const StreetSolver& solver, const StreetSolver::Options& options) {
  ByteSink out;
  solver.save(out);
  const std::vector<std::byte> bytes = out.bytes();
  ByteSource in(bytes);
  StreetSolver copy(options);
  copy.load(in);
  CHECK(in.empty());
  return copy;
}

}  // namespace

TEST_SUITE("sparse/incremental_cholesky_work") {
  // Counted, so the same on every machine but for rounding.
  TEST_CASE("in a town of short streets, what comes next mostly reaches what is eliminated late") {
    const StreetWalkOptions town{.sessions = 20, .keyframes = 1000, .blocks = 30, .block = 10, .seed = 2};
    const double work = late_work(town, {});
    CHECK(work == doctest::Approx(5.4e8).epsilon(0.05));
    CHECK(work < 0.4 * late_work(town, {.near_variables = 0}));
  }

  // 4.6e9 multiplications without it.
  TEST_CASE("in a larger town, the largest separators are seldom factorized, since what is far comes first") {
    if (quick()) return;
    const StreetWalkOptions town{.sessions = 16, .keyframes = 1000, .blocks = 50, .block = 4, .seed = 2};
    CHECK(late_work(town, {}) < 3.5e9);
  }

  TEST_CASE("surroundings are as before once a step elsewhere is undone, and as they were saved") {
    const StreetSolver::Options options{.near_variables = 10, .near_work = 0.0, .far_work = 1e4, .surroundings = 8};
    StreetWalk walk({.sessions = 4, .keyframes = 300, .blocks = 4, .block = 20, .seed = 5});
    StreetSolver solver(options), other(options);
    while (!walk.done()) {
      const StreetWalk::Step step = walk.next();
      if (other.size() % 17 == 16) {
        take(other, {.starts = true, .motion = {}, .closures = {{other.size() / 3, {}, false}}});
        other.rollback();
      }
      if (other.size() % 50 == 49) other = copy_of(other, options);
      for (StreetSolver* const each : {&solver, &other}) {
        each->reset_work();
        take(*each, step);
      }
      CHECK(solver.work().multiplications == other.work().multiplications);
      CHECK(solver.solution(solver.size() / 2)[0] == other.solution(solver.size() / 2)[0]);
    }
  }
}
