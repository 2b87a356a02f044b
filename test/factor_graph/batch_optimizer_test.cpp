#include "chainslam/factor_graph/batch_optimizer.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "chainslam/lie/se2.hpp"
#include "factor_graph/smoother_twin.hpp"
#include "support/property.hpp"
#include "support/quick.hpp"
#include "support/real_data.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

template <class Group>
double largest_difference(const Values<Group>& a, const Values<Group>& b) {
  double largest = 0.0;
  for (Key key = 0; key < a.size(); ++key) largest = std::max(largest, a[key].local(b[key]).norm());
  return largest;
}

template <class Group>
void hold_first(FactorGraph<Group>& graph) {
  graph.add_prior(0, graph[0], NoiseModel<Group::dof>::from_sigma(1e-3));
}

/// Stops a method after each of its first iterations, from starts that lie far off.
template <class Method>
void check_descent(Method method, Index iterations) {
  for_all(10, [&](Rng& rng, int size) {
    PoseGraph graph = random_graph<SE3d>(rng, size + 10, 0.05);
    hold_first(graph);
    for (Key key = 1; key < graph.values().size(); ++key)
      graph.set_value(key, graph[key].retract(random_tangent<SE3d>(rng, 3.0, 1.0)));
    double cost = graph.cost();
    for (method.max_iterations = 1; method.max_iterations < iterations; ++method.max_iterations) {
      PoseGraph again = graph;
      const OptimizeReport report = optimize(again, method);
      REQUIRE(report.ok());
      CHECK(report.final_cost <= cost);
      CHECK(report.final_cost == again.cost());
      cost = report.final_cost;
    }
  });
}

}  // namespace

TEST_SUITE("factor_graph/batch_optimizer") {
  // Optima from shared/data/pose_graphs/README.md: first pose fixed, exact Jacobians, minimized by another solver from
  // the chordal start. Graphs whose stored vertices lead into another valley are not listed.
  TEST_CASE("spatial benchmark graphs reach their known optimum from their own vertices" * doctest::skip(quick())) {
    struct Case {
      const char* name;
      double optimum;
    };
    for (const Case& known :
         {Case{"sphere2500", 1351.40193}, Case{"parking-garage", 1.2683848}, Case{"smallGrid3D", 1035.85066},
          Case{"tinyGrid3D", 18.6278189}, Case{"ms5x2000", 11695.7681}, Case{"ms5x2000_late", 9127.70901}}) {
      const auto path = real_data(std::string("pose_graphs/") + known.name + ".g2o");
      if (!path) continue;
      INFO(known.name);
      PoseGraph graph = make_graph(read_g2o(*path).spatial);
      const OptimizeReport report = optimize(graph, GaussNewton{});
      CHECK(report.status == OptimizeStatus::converged);
      CHECK(report.final_cost == doctest::Approx(known.optimum).epsilon(1e-7));  // all digits that are published
      CHECK(report.final_cost == graph.cost());
    }
  }

  TEST_CASE("planar benchmark graphs reach their known optimum with a user's own factor" * doctest::skip(quick())) {
    struct Case {
      const char* name;
      double optimum;
    };
    for (const Case& known : {Case{"manhattan", 3549.0368}, Case{"M3500_olson", 137.912951},
                              Case{"city10000", 511.985164}, Case{"intel", 45.0046958}}) {
      const auto path = real_data(std::string("pose_graphs/") + known.name + ".g2o");
      if (!path) continue;
      INFO(known.name);
      FactorGraph<SE2d, PlanarBetween> graph = make_planar_graph(read_g2o(*path).planar);
      const OptimizeReport report = optimize(graph, LevenbergMarquardt{});
      CHECK(report.status == OptimizeStatus::converged);
      CHECK(report.final_cost == doctest::Approx(known.optimum).epsilon(1e-6));
    }
  }

  TEST_CASE_TEMPLATE("all methods end in the same optimum, where the gradient vanishes", Group, SE3d, SE2d) {
    for_all(20, [](Rng& rng, int size) {
      FactorGraph<Group> graph = random_graph<Group>(rng, size + 2, 0.02);
      hold_first(graph);
      FactorGraph<Group> other = graph;
      FactorGraph<Group> third = graph;
      const OptimizeReport gauss_newton = optimize(graph, GaussNewton{});
      const OptimizeReport marquardt = optimize(other, LevenbergMarquardt{});
      const OptimizeReport dogleg = optimize(third, Dogleg{});
      REQUIRE(gauss_newton.status == OptimizeStatus::converged);
      REQUIRE(marquardt.status == OptimizeStatus::converged);
      REQUIRE(dogleg.status == OptimizeStatus::converged);
      CHECK(gauss_newton.final_cost == doctest::Approx(marquardt.final_cost).epsilon(1e-7));
      CHECK(gauss_newton.final_cost == doctest::Approx(dogleg.final_cost).epsilon(1e-7));
      CHECK(largest_difference(graph.values(), other.values()) < 1e-4);
      // no small move of a pose lowers the cost by more than the tolerance
      for (int trial = 0; trial < 20; ++trial) {
        Values<Group> moved = graph.values();
        const Key key = rng.uniform_index(moved.size());
        moved[key] = moved[key].retract(random_tangent<Group>(rng, 1e-4, 1e-4));
        CHECK(graph.cost(moved) > gauss_newton.final_cost - 1e-6);
      }
    });
  }

  TEST_CASE("nearly noiseless measurements give the true poses back") {
    Rng rng(3);
    PoseGraph graph = random_graph<SE3d>(rng, 40, 1e-7);
    graph.set_fixed(0);
    const Values<SE3d> truth = graph.values();
    for (Key key = 1; key < 40; ++key) graph.set_value(key, truth[key].retract(random_tangent<SE3d>(rng, 0.3, 0.1)));
    const OptimizeReport report = optimize(graph);
    CHECK(report.status == OptimizeStatus::converged);
    CHECK(largest_difference(graph.values(), truth) < 1e-5);  // 1e-7 a step, over 40 steps and levers of 20 m
  }

  TEST_CASE("the cost never rises with a dogleg, whose region shrinks until a step is good") {
    check_descent(Dogleg{.initial_radius = 100.0}, 12);
  }

  TEST_CASE("the cost never rises with Levenberg and Marquardt, wherever it starts") {
    check_descent(LevenbergMarquardt{}, 20);
  }

  TEST_CASE("parts that nothing holds are named before any number is touched") {
    Rng rng(5);
    PoseGraph graph = random_graph<SE3d>(rng, 10, 0.01);
    hold_first(graph);
    const auto noise = PoseGraph::Noise::from_sigma(0.1);
    for (int k = 0; k < 5; ++k) graph.add_value(random_pose<SE3d>(rng));  // 10 .. 14
    graph.add_between(12, 11, SE3d(), noise);
    graph.add_between(14, 12, SE3d(), noise);
    const Values<SE3d> before = graph.values();
    const OptimizeReport report = optimize(graph);
    CHECK(report.status == OptimizeStatus::unconstrained);
    CHECK(report.variables == std::vector<Key>{10, 11, 13});
    REQUIRE(report.free.size() == 3);
    CHECK(report.free[1].variables == 3);
    CHECK(report.free[1].directions.cols() == 6);
    CHECK(graph.values() == before);
    graph.set_fixed(10);
    graph.add_prior(14, graph[14], noise);
    graph.add_between(0, 13, SE3d(), noise);
    CHECK(optimize(graph).status == OptimizeStatus::converged);
  }

  TEST_CASE("a direction that is not measured is named, and the values stay") {
    PoseGraph graph;
    graph.add_value(SE3d());
    graph.add_value(SE3d());
    graph.add_prior(0, SE3d(), PoseGraph::Noise::from_sigma(1.0));
    Vector6d sigmas = Vector6d::Ones();
    sigmas[5] = std::numeric_limits<double>::infinity();  // no yaw
    graph.add_between(0, 1, SE3d::exp(Vector6d::Constant(0.1)), PoseGraph::Noise::from_sigmas(sigmas));
    const Values<SE3d> before = graph.values();
    const OptimizeReport gauss_newton = optimize(graph, GaussNewton{});
    CHECK(gauss_newton.status == OptimizeStatus::singular);
    REQUIRE(gauss_newton.variables.size() == 1);
    CHECK(!gauss_newton.ok());
    CHECK(graph.values() == before);
  }

  TEST_CASE("values that are not finite are a status") {
    PoseGraph graph;
    graph.add_value(SE3d(SO3d(), Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN())));
    graph.add_prior(0, SE3d(), PoseGraph::Noise::from_sigma(1.0));
    CHECK(optimize(graph, GaussNewton{}).status == OptimizeStatus::not_finite);
    CHECK(optimize(graph, LevenbergMarquardt{}).status == OptimizeStatus::not_finite);
  }

  TEST_CASE_TEMPLATE("a unary prior alone pulls its variable onto its mean", Group, SE3d, SE2d) {
    Rng rng(8);
    FactorGraph<Group> graph;
    std::vector<Group> means;
    for (Key key = 0; key < 5; ++key) {
      means.push_back(random_pose<Group>(rng));
      graph.add_value(means.back().retract(random_tangent<Group>(rng, 1.0, 0.3)));
      graph.add_prior(key, means.back(), random_noise<Group::dof>(rng));
    }
    CHECK(optimize(graph, GaussNewton{}).status == OptimizeStatus::converged);
    for (Key key = 0; key < 5; ++key) CHECK(graph[key].local(means[static_cast<std::size_t>(key)]).norm() < 1e-9);
  }

  TEST_CASE("two priors meet in the middle, weighed by their information") {
    FactorGraph<SE2d> graph;
    graph.add_value(SE2d());
    graph.add_prior(0, SE2d(), NoiseModel<3>::from_sigma(1.0));
    graph.add_prior(0, SE2d(SO2d(), {5.0, 0.0}), NoiseModel<3>::from_sigma(0.5));
    const OptimizeReport report = optimize(graph);
    CHECK(graph[0].translation()[0] == doctest::Approx(4.0));  // (1 * 0 + 4 * 5) / 5
    CHECK(report.final_cost == doctest::Approx(16.0 + 4.0));
  }

  TEST_CASE("a measurement given twice counts twice, and either way round") {
    Rng rng(9);
    PoseGraph graph = random_graph<SE3d>(rng, 30, 0.02);
    hold_first(graph);
    PoseGraph doubled = graph;
    const std::vector<BetweenFactor<SE3d>> factors(graph.betweens().begin(), graph.betweens().end());
    for (const auto& factor : factors) doubled.add(factor);
    PoseGraph stronger;
    for (const SE3d& value : graph.values()) stronger.add_value(value);
    hold_first(stronger);
    for (auto factor : factors) {
      factor.sqrt_information *= std::sqrt(2.0);
      stronger.add(factor);
    }
    REQUIRE(optimize(doubled).ok());
    REQUIRE(optimize(stronger).ok());
    CHECK(largest_difference(doubled.values(), stronger.values()) < 1e-6);
  }

  TEST_CASE("fixed variables do not move, and hold the rest") {
    Rng rng(10);
    PoseGraph graph = random_graph<SE3d>(rng, 20, 0.02);
    for (const Key key : {4, 11}) graph.set_fixed(key);
    const Values<SE3d> before = graph.values();
    REQUIRE(optimize(graph).status == OptimizeStatus::converged);
    CHECK(graph[4] == before[4]);
    CHECK(graph[11] == before[11]);
    CHECK(!(graph[5] == before[5]));
    for (Key key = 0; key < 20; ++key) graph.set_fixed(key);
    const OptimizeReport report = optimize(graph);
    CHECK(report.status == OptimizeStatus::converged);
    CHECK(report.final_cost == report.initial_cost);
  }

  TEST_CASE("a robust kernel keeps a false closure from bending the map") {
    Rng rng(11);
    Graph graph;
    PoseGraph clean = random_graph<SE3d>(rng, 60, 0.01);
    hold_first(clean);
    for (const SE3d& value : clean.values()) graph.add_value(value);
    for (const auto& factor : clean.betweens()) graph.add(factor);
    for (const auto& factor : clean.priors()) graph.add(factor);
    graph.add(Closure{3, 50, SE3d(), PoseGraph::Noise::from_sigma(0.01).sqrt_information(), Cauchy{.width = 1.0}});
    REQUIRE(optimize(clean).ok());
    REQUIRE(optimize(graph).ok());
    CHECK(largest_difference(graph.values(), clean.values()) < 0.01);
  }

  TEST_CASE("a second optimization has nothing left to do") {
    Rng rng(12);
    PoseGraph graph = random_graph<SE3d>(rng, 100, 0.02);
    hold_first(graph);
    const OptimizeReport first = optimize(graph, GaussNewton{});
    const OptimizeReport second = optimize(graph, GaussNewton{});
    CHECK(second.status == OptimizeStatus::converged);
    CHECK(second.iterations == 1);
    CHECK(second.final_cost == doctest::Approx(first.final_cost).epsilon(1e-8));
  }

  TEST_CASE("the same graph gives the same bits; another solver the same optimum") {
    Rng rng(13);
    PoseGraph graph = random_graph<SE3d>(rng, 80, 0.02);
    hold_first(graph);
    PoseGraph same = graph;
    PoseGraph other = graph;
    BlockCholesky<6, Natural> natural;
    REQUIRE(optimize(graph).ok());
    REQUIRE(optimize(same).ok());
    REQUIRE(optimize(other, LevenbergMarquardt{}, natural).ok());
    CHECK(graph.values() == same.values());
    CHECK(largest_difference(graph.values(), other.values()) < 1e-6);
  }

  TEST_CASE("the limit of iterations is a status, and the values are better than before") {
    Rng rng(14);
    PoseGraph graph = random_graph<SE3d>(rng, 50, 0.1);
    hold_first(graph);
    const OptimizeReport report = optimize(graph, LevenbergMarquardt{.max_iterations = 1});
    CHECK(report.status == OptimizeStatus::iteration_limit);
    CHECK(report.iterations == 1);
    CHECK(report.final_cost < report.initial_cost);
  }

  TEST_CASE("an empty graph is optimal") {
    PoseGraph graph;
    const OptimizeReport report = optimize(graph);
    CHECK(report.status == OptimizeStatus::converged);
    CHECK(report.final_cost == 0.0);
  }
}
