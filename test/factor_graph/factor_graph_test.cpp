#include "chainslam/factor_graph/factor_graph.hpp"

#include <doctest/doctest.h>

#include <stdexcept>

#include "chainslam/lie/se2.hpp"
#include "factor_graph/pose_graphs.hpp"

using namespace chainslam;
using namespace chainslam::test;

TEST_SUITE("factor_graph/factor_graph") {
  TEST_CASE("keys count from 0 in the order of adding") {
    PoseGraph graph;
    CHECK(graph.add_value(SE3d()) == 0);
    CHECK(graph.add_value(SE3d()) == 1);
    CHECK(graph.values().size() == 2);
    CHECK(graph.factor_count() == 0);
  }

  TEST_CASE("unknown and repeated keys are refused at the door") {
    PoseGraph graph;
    graph.add_value(SE3d());
    const auto noise = PoseGraph::Noise::from_sigma(1.0);
    CHECK_THROWS_AS(graph.add_prior(1, SE3d(), noise), std::invalid_argument);
    CHECK_THROWS_AS(graph.add_prior(-1, SE3d(), noise), std::invalid_argument);
    CHECK_THROWS_AS(graph.add_between(0, 1, SE3d(), noise), std::invalid_argument);
    CHECK_THROWS_AS(graph.add_between(0, 0, SE3d(), noise), std::invalid_argument);
    CHECK_THROWS_AS(graph.set_fixed(3), std::invalid_argument);
    CHECK_THROWS_AS(graph.set_value(3, SE3d()), std::invalid_argument);
    CHECK_THROWS_AS(graph.set_values({}), std::invalid_argument);
    CHECK(graph.factor_count() == 0);
  }

  TEST_CASE("the cost is the sum of squared whitened residuals, through the kernels") {
    FactorGraph<SE2d, BetweenFactor<SE2d, Huber>> graph;
    graph.add_value(SE2d());
    graph.add_value(SE2d(SO2d(), {3.0, 0.0}));
    const auto noise = NoiseModel<3>::from_sigma(0.5);
    graph.add_prior(0, SE2d(SO2d(), {1.0, 0.0}), noise);
    CHECK(graph.cost() == doctest::Approx(4.0));
    graph.add_between(0, 1, SE2d(SO2d(), {1.0, 0.0}), noise);
    CHECK(graph.cost() == doctest::Approx(4.0 + 16.0));
    graph.add(
        BetweenFactor<SE2d, Huber>{0, 1, SE2d(SO2d(), {1.0, 0.0}), noise.sqrt_information(), Huber{.width = 1.0}});
    CHECK(graph.cost() == doctest::Approx(4.0 + 16.0 + (2.0 * 4.0 - 1.0)));
    CHECK(graph.factor_count() == 3);
  }

  TEST_CASE("factors can be removed, the others stay in order") {
    PoseGraph graph;
    for (int k = 0; k < 4; ++k) graph.add_value(SE3d());
    for (Key k = 1; k < 4; ++k) graph.add_between(0, k, SE3d(), PoseGraph::Noise::from_sigma(1.0));
    const auto leads_to_2 = [](const BetweenFactor<SE3d>& factor) { return factor.to == 2; };
    CHECK(graph.remove_factors<BetweenFactor<SE3d>>(leads_to_2) == 1);
    REQUIRE(graph.betweens().size() == 2);
    CHECK(graph.betweens()[0].to == 1);
    CHECK(graph.betweens()[1].to == 3);
  }
}
