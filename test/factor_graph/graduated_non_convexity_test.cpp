#include "chainslam/factor_graph/outlier_rejection.hpp"

#include <doctest/doctest.h>

#include <vector>

#include "chainslam/lie/se2.hpp"
#include "factor_graph/pose_graphs.hpp"
#include "support/property.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

/// Whether a factor is a closure rather than odometry.
constexpr auto is_closure = [](const auto& factor) { return factor.to != factor.from + 1; };

}  // namespace

TEST_SUITE("factor_graph/graduated_non_convexity") {
  TEST_CASE("the threshold is the 99th percentile of chi^2, by the tables") {
    CHECK(chi_squared_99(1) == doctest::Approx(6.635).epsilon(0.012));
    CHECK(chi_squared_99(3) == doctest::Approx(11.345).epsilon(0.005));
    CHECK(chi_squared_99(6) == doctest::Approx(16.812).epsilon(0.003));
  }

  TEST_CASE_TEMPLATE("a third of the closures may lie: they are told from the others, and the rest has its optimum",
                     Group, SE3d, SE2d) {
    for_all(6, [](Rng& rng, int) {
      FactorGraph<Group> honest = random_graph<Group>(rng, 60, 0.02);
      honest.set_fixed(0);
      FactorGraph<Group> graph = honest;
      for (int k = 0; k < 14; ++k) {
        const Key from = rng.uniform_index(30);
        const Group wrong =
            honest[from].inverse() * honest[from + 25] * Group::exp(random_tangent<Group>(rng, 3.0, 0.5));
        graph.add_between(from, from + 25, wrong, NoiseModel<Group::dof>::from_sigma(0.02));
      }
      const GncReport report = optimize(graph, GraduatedNonConvexity{}, is_closure);
      REQUIRE(report.last.ok());
      CHECK(report.decided);
      std::size_t liars_in = 0, honest_out = 0;
      for (std::size_t k = 0; k < report.weights.size(); ++k) {
        const bool liar = k >= honest.betweens().size();
        if (liar && report.weights[k] > 0.0) ++liars_in;
        if (!liar && report.weights[k] < 1.0) ++honest_out;
      }
      CHECK(liars_in == 0);
      CHECK(honest_out <= 2);  // of 30, by one in a hundred each
      REQUIRE(optimize(honest).ok());
      double most = 0.0;
      for (Key key = 0; key < 60; ++key) most = std::max(most, graph[key].local(honest[key]).norm());
      CHECK(most < 0.2);  // where an honest closure is out
    });
  }

  TEST_CASE("where nobody lies, nothing changes") {
    Rng rng(2);
    PoseGraph graph = random_graph<SE3d>(rng, 40, 1e-3);
    graph.set_fixed(0);
    PoseGraph plain = graph;
    const GncReport report = optimize(graph, GraduatedNonConvexity{.threshold = 100.0}, is_closure);
    CHECK(report.steps == 1);
    CHECK(report.decided);
    for (const double weight : report.weights) CHECK(weight == 1.0);
    REQUIRE(optimize(plain).ok());
    CHECK(graph.cost() == doctest::Approx(plain.cost()).epsilon(1e-5));
  }

  TEST_CASE("what fails leaves the graph as it was") {
    Rng rng(3);
    PoseGraph graph = random_graph<SE3d>(rng, 10, 0.01);
    const Values<SE3d> before = graph.values();
    const GncReport report = optimize(graph, GraduatedNonConvexity{}, is_closure);
    CHECK(report.last.status == OptimizeStatus::unconstrained);
    CHECK(graph.values() == before);
  }
}
