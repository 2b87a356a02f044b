#include <doctest/doctest.h>

#include <Eigen/Cholesky>
#include <array>
#include <limits>
#include <string>
#include <vector>

#include "chainslam/factor_graph/batch_optimizer.hpp"
#include "chainslam/factor_graph/gnss_factor.hpp"
#include "chainslam/factor_graph/gravity_factor.hpp"
#include "chainslam/factor_graph/incremental_smoother.hpp"
#include "chainslam/factor_graph/marginals.hpp"
#include "factor_graph/smoother_twin.hpp"
#include "support/property.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

/// How the parts of a chain of poses can move that only some factors on single poses hold.
template <class... Factors>
std::string freedom_of_chain(const Values<SE3d>& values, const Factors&... factors) {
  detail::HeldComponents<SE3d> components;
  for (Key key = 0; key < values.size(); ++key) components.add_variable();
  (components.connect(factors, values), ...);
  for (Key key = 1; key < values.size(); ++key) components.connect(std::array<Key, 2>{key - 1, key});
  const std::vector<FreePart> parts = components.free_parts(components.floating(), values);
  return parts.empty() ? "" : describe(parts.front());
}

}  // namespace

TEST_SUITE("factor_graph/incremental_smoother_queries") {
  TEST_CASE("what factors on single poses leave free of a part is named, wherever it lies and is joined") {
    Values<SE3d> values;
    for (int k = 0; k < 4; ++k)
      values.add(SE3d(SO3d::exp({0.1, 0.2, 0.7 * k}), Eigen::Vector3d(4e5 + 3.0 * k, 5e6 + k * k, 100.0)));
    const auto fix = [&](Key key, const Eigen::Vector3d& arm) {
      return GnssFactor<>{key, values[key] * arm, arm, SqrtInformation<3>::Identity() / 0.05};
    };
    const auto gravity = [&](Key key) {
      return GravityFactor<>{key, S2<double>::from_vector(values[key].rotation().inverse() * Eigen::Vector3d::UnitZ()), 0.01};
    };
    const Eigen::Vector3d none = Eigen::Vector3d::Zero(), arm(0.3, 0, 1);
    CHECK(freedom_of_chain(values) == "variable 0 (4 variables) is free in translation, rotation (6 directions)");
    CHECK(freedom_of_chain(values, fix(0, none)) == "variable 0 (4 variables) is free in rotation (3 directions)");
    CHECK(freedom_of_chain(values, gravity(2)) ==
          "variable 0 (4 variables) is free in translation, yaw (4 directions, as seen at variable 2)");
    CHECK(freedom_of_chain(values, gravity(2), gravity(3), gravity(0)).find("translation, yaw (4") < 60);
    CHECK(freedom_of_chain(values, gravity(1), fix(1, none)) ==
          "variable 0 (4 variables) is free in yaw (1 direction, as seen at variable 1)");
    CHECK(freedom_of_chain(values, fix(0, arm)).find("(3 directions)") != std::string::npos);
    CHECK(freedom_of_chain(values, fix(0, arm), fix(3, arm)).find("(1 direction)") != std::string::npos);
    CHECK(freedom_of_chain(values, fix(0, arm), fix(3, none), fix(1, arm)) == "");
    CHECK(freedom_of_chain(values, fix(3, none), fix(0, none), gravity(1)) == "");
  }

  TEST_CASE("a smoother refuses what is held in some directions only, says which, and takes the rest later") {
    Smoother smoother;
    const auto noise = Smoother::Noise::from_sigma(0.1);
    Vector6d sigmas = Vector6d::Constant(0.1);
    sigmas.tail<3>().setConstant(std::numeric_limits<double>::infinity());
    for (Key key = 0; key < 5; ++key) {
      smoother.add_value(SE3d(SO3d(), {1.0 * key, 0.1 * key * key, 0}));
      if (key > 0) smoother.add_between(key - 1, key, smoother[key - 1].inverse() * smoother[key], noise);
    }
    smoother.add_prior(1, smoother[1], Smoother::Noise::from_sigmas(sigmas));
    CHECK(smoother.floating() == std::vector<Key>{0});
    smoother.add_prior(3, smoother[3], Smoother::Noise::from_sigmas(sigmas));
    smoother.add_prior(4, smoother[4], Smoother::Noise::from_sigmas(sigmas));
    CHECK(smoother.floating().empty());
    REQUIRE(smoother.update().ok());
    smoother.add_value(SE3d());
    smoother.add_value(SE3d());
    smoother.add_between(5, 6, SE3d(), noise);
    smoother.add_prior(6, SE3d(), Smoother::Noise::from_sigmas(sigmas));
    const UpdateReport report = smoother.update();
    CHECK(report.status == UpdateStatus::unconstrained);
    REQUIRE(report.free.size() == 1);
    CHECK(describe(report.free[0]) ==
          "variable 5 (2 variables) is free in rotation (3 directions, as seen at variable 6)");
    CHECK(smoother.size() == 5);
  }

  TEST_CASE("directions that only the numbers show are named, with all that moves along") {
    Smoother smoother;
    const auto noise = Smoother::Noise::from_sigma(0.1);
    Vector6d sigmas = Vector6d::Constant(0.1);
    sigmas[2] = std::numeric_limits<double>::infinity();
    for (Key key = 0; key < 9; ++key) {
      smoother.add_value(SE3d(SO3d(), {1.0 * key, 0, 0}));
      if (key == 0) smoother.add_prior(0, SE3d(), noise);
      if (key > 0)
        smoother.add_between(key - 1, key, SE3d(SO3d(), {1, 0, 0}),
                             key == 4 ? Smoother::Noise::from_sigmas(sigmas) : noise);
    }
    FactorGraph<SE3d, Closure> graph;
    for (Key key = 0; key < 9; ++key) graph.add_value(smoother[key]);
    const UpdateReport report = smoother.update();
    CHECK(report.status == UpdateStatus::singular);
    REQUIRE(report.free.size() == 1);
    CHECK(describe(report.free[0]).starts_with("variable 4 (5 variables) is free in z (1 direction"));
    graph.add_prior(0, SE3d(), noise);
    for (Key key = 1; key < 9; ++key)
      graph.add_between(key - 1, key, SE3d(SO3d(), {1, 0, 0}), key == 4 ? Smoother::Noise::from_sigmas(sigmas) : noise);
    const OptimizeReport batch = optimise(graph, GaussNewton{});
    CHECK(batch.status == OptimizeStatus::singular);
    REQUIRE(batch.free.size() == 1);
    CHECK(describe(batch.free[0]).starts_with("variable 4 (5 variables) is free in z (1 direction"));
  }

  TEST_CASE("covariances are blocks of the dense inverse, also between variables; fixed ones have none") {
    for_all(10, [](Rng& rng, int size) {
      Twin twin;
      Walk walk(rng);
      for (int k = 0; k < 5 + size; ++k) walk.step(twin);
      REQUIRE(twin.smoother.converge().ok());
      const FactorGraph<SE3d, Closure> graph = twin.graph(twin.smoother.values());
      detail::NormalEquations<FactorGraph<SE3d, Closure>> equations(graph);
      equations.linearize(graph, graph.values());
      const Eigen::Index rows = Eigen::Index{twin.smoother.size()} * 6;
      Eigen::MatrixXd H(rows, rows);
      for (Eigen::Index k = 0; k < rows; ++k) H.col(k) = equations.matrix() * Eigen::VectorXd::Unit(rows, k);
      const Eigen::MatrixXd inverse = H.llt().solve(Eigen::MatrixXd::Identity(rows, rows));
      const Key last = twin.smoother.size() - 1;
      const std::vector<Key> keys{last, 1, 2};
      const Eigen::MatrixXd found = twin.smoother.covariance(keys);
      for (Eigen::Index a = 0; a < 3; ++a) {
        for (Eigen::Index b = 0; b < 3; ++b) {
          const Matrix6d expected = inverse.block<6, 6>(Eigen::Index{keys[static_cast<std::size_t>(a)]} * 6,
                                                        Eigen::Index{keys[static_cast<std::size_t>(b)]} * 6);
          CHECK((found.block<6, 6>(6 * a, 6 * b) - expected).norm() < 1e-5 * inverse.norm());
        }
      }
      CHECK(twin.smoother.covariance(1) == twin.smoother.covariance(std::vector<Key>{1}));
      const auto marginal = twin.smoother.marginals();
      const auto batch = marginals(graph);
      REQUIRE(batch);
      for (Key key = 0; key <= last; ++key) {
        const auto k = static_cast<std::size_t>(key);
        CHECK((marginal[k] - twin.smoother.covariance(key)).norm() < 1e-9 * marginal[k].norm());
        CHECK((marginal[k] - (*batch)[k]).norm() < 1e-5 * inverse.norm());
      }
      twin.smoother.set_fixed(1);
      REQUIRE(twin.smoother.update().ok());
      CHECK(twin.smoother.covariance(1).isZero(0));
      CHECK(twin.smoother.marginals()[1].isZero(0));
    });
  }

  TEST_CASE("what a factor would raise the squared error by is what it does") {
    for_all(20, [](Rng& rng, int size) {
      Twin twin;
      Walk walk(rng);
      for (int k = 0; k < 5 + size; ++k) walk.step(twin);
      REQUIRE(twin.smoother.converge().ok());
      const double before = twin.smoother.cost();
      const Key last = twin.smoother.size() - 1;
      BetweenFactor<SE3d> factor{1, last, twin.smoother[1].inverse() * twin.smoother[last], {}};
      factor.measurement = factor.measurement * SE3d::exp(random_tangent<SE3d>(rng, 0.003, 0.003));
      factor.sqrt_information = Smoother::Noise::from_sigma(0.02).sqrt_information();
      const FactorForecast forecast = twin.smoother.what_if(factor);
      CHECK(forecast.squared_residual == doctest::Approx(factor.residual(twin.smoother.values()).squaredNorm()));
      CHECK(forecast.rise <= forecast.squared_residual);
      const FactorId id = twin.smoother.add(factor);
      REQUIRE(twin.smoother.converge().ok());
      // kernels and curvature are not in the forecast
      CHECK(twin.smoother.cost() - before == doctest::Approx(forecast.rise).epsilon(0.05).scale(0.1));
      twin.smoother.remove(id);
      REQUIRE(twin.smoother.converge().ok());
      CHECK(twin.smoother.cost() == doctest::Approx(before).epsilon(1e-6));
    });
  }

  TEST_CASE("a session moved as one body costs its ties alone, and leads to the same optimum") {
    Rng rng(5);
    Twin twin;
    const auto noise = Smoother::Noise::from_sigma(0.01).sqrt_information();
    const auto weak = Smoother::Noise::from_sigma(100.0).sqrt_information();
    const SE3d offset = SE3d::exp((Vector6d() << 40, -25, 1, 0.1, 0.2, 2.5).finished());
    std::vector<Key> second;
    for (Key key = 0; key < 400; ++key) {
      const bool later = key >= 200;
      const SE3d guess = (later ? offset : SE3d()) * SE3d(SO3d(), {key % 200 * 1.0, 0, 0});
      twin.add_value(guess);
      if (later) second.push_back(key);
      if (key % 200 == 0) twin.add(PriorFactor<SE3d>{key, guess, later ? weak : noise});
      const SE3d step = SE3d(SO3d(), {1, 0, 0}) * SE3d::exp(random_tangent<SE3d>(rng, 0.01, 0.001));
      if (key % 200 > 0) twin.add(BetweenFactor<SE3d>{key - 1, key, step, noise});
    }
    REQUIRE(twin.smoother.update().ok());
    REQUIRE(twin.smoother.converge().ok());
    const Values<SE3d> before = twin.smoother.values();
    twin.smoother.move(second, offset.inverse());
    for (const Key key : second) CHECK(twin.smoother[key].local(offset.inverse() * before[key]).norm() < 1e-9);
    twin.add(BetweenFactor<SE3d>{50, 250, SE3d(SO3d(), {0, 1, 0}), noise});
    twin.add(BetweenFactor<SE3d>{150, 350, SE3d(SO3d(), {0, 1, 0}), noise});
    const UpdateReport report = twin.smoother.update();
    REQUIRE(report.ok());
    CHECK(report.relinearized < 10);
    REQUIRE(twin.smoother.converge().ok());
    FactorGraph<SE3d, Closure> graph = twin.graph(twin.smoother.values());
    REQUIRE(optimise(graph).ok());
    CHECK(twin.smoother.cost() == doctest::Approx(graph.cost()).epsilon(1e-6));
    CHECK(largest_difference(twin.smoother.values(), graph.values()) < 1e-3);
    CHECK_THROWS_AS(twin.smoother.move(std::vector<Key>{400}, offset), std::invalid_argument);
  }

  TEST_CASE("a move can be undone before and after its update") {
    Rng rng(6);
    Twin twin;
    Walk walk(rng);
    for (int k = 0; k < 30; ++k) walk.step(twin);
    REQUIRE(twin.smoother.update().ok());
    const Values<SE3d> before = twin.smoother.values();
    const std::vector<Key> keys{20, 21, 22, 23, 24, 25, 26, 27, 28, 29};
    twin.smoother.move(keys, random_pose<SE3d>(rng));
    CHECK(!(twin.smoother.values() == before));
    twin.smoother.undo();
    CHECK(twin.smoother.values() == before);
    twin.smoother.move(keys, random_pose<SE3d>(rng));
    REQUIRE(twin.smoother.update().ok());
    twin.smoother.undo();
    CHECK(twin.smoother.values() == before);
  }
}
