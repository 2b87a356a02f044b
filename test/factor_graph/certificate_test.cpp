#include "chainslam/factor_graph/certificate.hpp"

#include <doctest/doctest.h>

#include <cstdio>
#include <numbers>
#include <string>

#include "factor_graph/pose_graphs.hpp"
#include "support/property.hpp"
#include "support/quick.hpp"
#include "support/real_data.hpp"

using namespace chainslam;
using namespace chainslam::test;

TEST_SUITE("factor_graph/certificate") {
  TEST_CASE_TEMPLATE("at the global optimum, the bound is the cost", Group, SE3d, SE2d) {
    for_all(8, [](Rng& rng, int size) {
      FactorGraph<Group> graph = random_graph<Group>(rng, size + 4, 0.01);
      graph.set_fixed(0);
      REQUIRE(optimize(graph).ok());
      const auto certificate = certify(graph);
      REQUIRE(certificate);
      CHECK(certificate->cost == graph.cost());
      // chords are shorter than angles, by their squares: 1e-4 of the cost at some hundredths of a radian
      CHECK(certificate->gap() <= 1e-3 * graph.cost() + 1e-6);
      CHECK(certificate->gap() >= -1e-9 * graph.cost());
    });
  }

  TEST_CASE("whatever the noise and the values, nothing costs less than the bound") {
    for_all(10, [](Rng& rng, int size) {
      PoseGraph graph;
      for (Key key = 0; key < size + 4; ++key) graph.add_value(random_pose<SE3d>(rng));
      for (Key key = 1; key < size + 4; ++key) {
        graph.add_between(key - 1, key, random_pose<SE3d>(rng), random_noise<6>(rng));
        if (key > 2) graph.add_between(rng.uniform_index(key - 1), key, random_pose<SE3d>(rng), random_noise<6>(rng));
      }
      graph.add_prior(0, graph[0], random_noise<6>(rng));
      const auto certificate = certify(graph);
      REQUIRE(certificate);
      CHECK(certificate->lower_bound <= certificate->cost);
      REQUIRE(optimize(graph).ok());
      CHECK(certificate->lower_bound <= graph.cost());
    });
  }

  TEST_CASE("a ring that is wound the wrong way is told from the optimum") {
    FactorGraph<SE2d> graph;
    constexpr int size = 12;
    const SE2d step(SO2d::from_angle(2 * std::numbers::pi / size), {1, 0});
    for (int k = 0; k < size; ++k) graph.add_value(SE2d());
    for (int k = 0; k < size; ++k)
      graph.add_between(k, (k + 1) % size, step, NoiseModel<3>::from_sigmas({0.1, 0.1, 0.1}));
    graph.set_fixed(0);
    REQUIRE(optimize(graph).ok());
    CHECK(graph.cost() > 100.0);
    const auto wound = certify(graph);
    REQUIRE(wound);
    CHECK(wound->gap() > 0.5 * wound->cost);
    const auto start = chordal_initialization(graph);
    REQUIRE(start);
    graph.set_values(*start);
    REQUIRE(optimize(graph).ok());
    CHECK(graph.cost() < 1e-9);
  }

  // Isotropic noise: f_SE of shared/data/pose_graphs/README.md is certified there for some of these.
  TEST_CASE("real graphs are at their global optimum, or say how far they may be" * doctest::skip(quick())) {
    for (const char* name : {"sphere2500", "torus3D", "parking-garage", "ms5x2000", "smallGrid3D", "tinyGrid3D"}) {
      const auto path = real_data(std::string("pose_graphs/") + name + ".g2o");
      if (!path) continue;
      INFO(std::string(name));
      PoseGraph graph = make_graph(read_g2o(*path).spatial);
      const auto start = chordal_initialization(graph);
      REQUIRE(start);
      graph.set_values(*start);
      REQUIRE(optimize(graph).ok());
      const auto certificate = certify(graph);
      REQUIRE(certificate);
      std::printf("FIGURE certificate, %s: cost %.6g, no less than %.6g\n", name, certificate->cost,
                  certificate->lower_bound);
      CHECK(certificate->lower_bound <= certificate->cost * (1 + 1e-9));
    }
  }
}
