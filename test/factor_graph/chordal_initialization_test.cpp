#include "chainslam/factor_graph/chordal_initialization.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <string>

#include "chainslam/factor_graph/batch_optimizer.hpp"
#include "factor_graph/pose_graphs.hpp"
#include "support/property.hpp"
#include "support/quick.hpp"
#include "support/real_data.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

template <class Group>
void forget_values(FactorGraph<Group>& graph) {
  for (Key key = 0; key < graph.values().size(); ++key) {
    if (!graph.is_fixed(key)) graph.set_value(key, Group());
  }
}

/// The optimum from the chordal start.
template <class Graph>
double optimum_from_chordal(Graph graph) {
  const auto start = chordal_initialization(graph);
  REQUIRE(start);
  graph.set_values(*start);
  const OptimizeReport report = optimize(graph, LevenbergMarquardt{.max_iterations = 300});
  CHECK(report.status == OptimizeStatus::converged);
  return report.final_cost;
}

struct KnownOptimum {
  const char* name;
  double cost;
};

}  // namespace

TEST_SUITE("factor_graph/chordal_initialization") {
  TEST_CASE_TEMPLATE("without noise it is exact, whatever the values are", Group, SE3d, SE2d) {
    for_all(20, [](Rng& rng, int size) {
      FactorGraph<Group> graph = random_graph<Group>(rng, size + 3, 1e-7);
      const Values<Group> truth = graph.values();
      if (size % 2 == 0) {
        graph.set_fixed(size / 2);
      } else {
        graph.add_prior(1, truth[1], NoiseModel<Group::dof>::from_sigma(1e-3));
      }
      forget_values(graph);
      const auto found = chordal_initialization(graph);
      REQUIRE(found);
      for (Key key = 0; key < truth.size(); ++key) CHECK((*found)[key].local(truth[key]).norm() < 1e-4);
      if (size % 2 == 0) CHECK((*found)[size / 2] == truth[size / 2]);
    });
  }

  TEST_CASE("what nothing holds in place, or no relative pose ties, has no answer") {
    Rng rng(1);
    PoseGraph graph = random_graph<SE3d>(rng, 10, 0.1);
    CHECK(!chordal_initialization(graph));
    graph.set_fixed(0);
    CHECK(chordal_initialization(graph));
    graph.add_value(SE3d());
    CHECK(!chordal_initialization(graph));
  }

  TEST_CASE("directions that are measured badly count little") {
    PoseGraph graph;
    Vector6d good = Vector6d::Constant(0.01), bad_height = good;
    bad_height[2] = 100.0;
    for (int k = 0; k < 3; ++k) graph.add_value(SE3d());
    graph.set_fixed(0);
    graph.add_between(0, 1, SE3d(SO3d::exp({0, 0, 1}), {1, 0, 0}), NoiseModel<6>::from_sigmas(good));
    graph.add_between(1, 2, SE3d(SO3d(), {0, 2, 5}), NoiseModel<6>::from_sigmas(bad_height));
    const SE3d T_0_2 = SE3d(SO3d::exp({0, 0, 1}), {1, 0, 0}) * SE3d(SO3d(), {0, 2, 0.5});
    graph.add_between(0, 2, T_0_2, NoiseModel<6>::from_sigmas(good));
    const auto found = chordal_initialization(graph);
    REQUIRE(found);
    CHECK((*found)[2].local(T_0_2).norm() < 1e-5);
  }

  // Optima from shared/data/pose_graphs/README.md, which come from the same start. Odometry alone leads elsewhere.
  TEST_CASE("spatial benchmark graphs reach their known optimum from there" * doctest::skip(quick())) {
    for (const KnownOptimum& known :
         {KnownOptimum{"torus3D", 24235.2738}, KnownOptimum{"cubicle", 2745.55586},
          KnownOptimum{"sphere_bignoise", 2988337.51}, KnownOptimum{"parking-garage", 1.2683848},
          KnownOptimum{"smallGrid3D", 1035.85066}, KnownOptimum{"tinyGrid3D", 18.6278189}}) {
      const auto path = real_data(std::string("pose_graphs/") + known.name + ".g2o");
      if (!path) continue;
      INFO(known.name);
      CHECK(optimum_from_chordal(make_graph(read_g2o(*path).spatial)) <= (1 + 1e-6) * known.cost);
    }
  }

  // Where digits are few, the next one is rounded up.
  TEST_CASE("planar benchmark graphs reach their known optimum from there" * doctest::skip(quick())) {
    for (const KnownOptimum& known :
         {KnownOptimum{"manhattan", 3549.0368}, KnownOptimum{"M3500_olson", 137.912951},
          KnownOptimum{"city10000", 511.985164}, KnownOptimum{"intel", 45.0046958},
          KnownOptimum{"intel_1228", 215.831544}, KnownOptimum{"MIT", 41.1632688}, KnownOptimum{"CSAIL", 40.5551289},
          KnownOptimum{"ais2klinik", 172.815579}, KnownOptimum{"kitti_00", 98.32205},
          KnownOptimum{"kitti_02", 78.76435}, KnownOptimum{"kitti_05", 157.10445}, KnownOptimum{"kitti_06", 25.94715},
          KnownOptimum{"kitti_07", 12.66105}, KnownOptimum{"kitti_09", 34.38285}}) {
      const auto path = real_data(std::string("pose_graphs/") + known.name + ".g2o");
      if (!path) continue;
      INFO(known.name);
      CHECK(optimum_from_chordal(make_planar_graph(read_g2o(*path).planar)) <= (1 + 1e-6) * known.cost);
    }
  }
}
