#include <doctest/doctest.h>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/factor_graph/batch_optimizer.hpp"
#include "support/street_walk.hpp"
#include "support/threads_cases.hpp"

using namespace chainslam;

TEST_SUITE("factor_graph/batch_optimizer") {
  THREADS_TEST_CASE("factor_graph/batch_optimizer",
                    "an optimization on several threads is bit-identical to one on one") {
    const auto walk = [] { return test::StreetWalk({.sessions = 2, .keyframes = 300, .blocks = 2}).graph(); };
    PoseGraph one = walk(), four = walk();
    REQUIRE(optimize(one, GaussNewton{}).ok());
    REQUIRE(optimize(four, GaussNewton{}, ThreadPool(4)).ok());
    CHECK(four.values() == one.values());
  }
}
