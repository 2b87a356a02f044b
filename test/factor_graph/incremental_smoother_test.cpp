#include "chainslam/factor_graph/incremental_smoother.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <string>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/factor_graph/batch_optimizer.hpp"
#include "chainslam/lie/se2.hpp"
#include "factor_graph/smoother_twin.hpp"
#include "support/property.hpp"
#include "support/quick.hpp"
#include "support/real_data.hpp"
#include "support/street_walk.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

/// One step of Gauss and Newton by the batch optimizer, whatever it does to the cost.
Values<SE3d> gauss_newton_step(Graph graph) {
  detail::NormalEquations<Graph> equations(graph);
  equations.linearize(graph, graph.values());
  BlockCholesky<6> solver;
  solver.analyze(equations.matrix().pattern());
  REQUIRE(solver.factorize(equations.matrix()).ok());
  Eigen::VectorXd step = -equations.gradient();
  solver.solve({step.data(), static_cast<std::size_t>(step.size())});
  Values<SE3d> values = graph.values();
  equations.retract(step, values, values);
  return values;
}

/// Feeds a graph pose by pose, each with the factors that lead back from it.
template <class Fed = Smoother, class Group>
Fed fed(const FactorGraph<Group>& graph, const SmootherOptions& options, bool chain_guess) {
  Fed smoother(options);
  std::vector<std::vector<BetweenFactor<Group>>> by_newest(static_cast<std::size_t>(graph.values().size()));
  for (const auto& factor : graph.betweens())
    by_newest[static_cast<std::size_t>(std::max(factor.from, factor.to))].push_back(factor);
  for (Key key = 0; key < graph.values().size(); ++key) {
    Group guess = graph[key];
    bool tied = false;
    for (const auto& factor : by_newest[static_cast<std::size_t>(key)]) {
      if (!chain_guess || factor.from != key - 1) continue;
      guess = smoother[factor.from] * factor.measurement;
      tied = true;
    }
    smoother.add_value(guess);
    if (key == 0) smoother.set_fixed(0);
    if (key > 0 && !tied && by_newest[static_cast<std::size_t>(key)].empty())
      smoother.add_prior(key, guess, NoiseModel<Group::dof>::from_sigma(10.0));
    for (const auto& factor : by_newest[static_cast<std::size_t>(key)]) smoother.add(factor);
    REQUIRE(smoother.update().ok());
  }
  return smoother;
}

}  // namespace

TEST_SUITE("factor_graph/incremental_smoother") {
  TEST_CASE("with tolerances at 0, every step of random histories is the batch optimizer's step") {
    for_all(30, [](Rng& rng, int size) {
      Twin twin(exact);
      Walk walk(rng);
      for (int k = 0; k < 4 + size / 3; ++k) {
        for (Index count = rng.uniform_index(3); count >= 0; --count) walk.step(twin);
        if (k % 4 == 3) walk.remove_one(twin);
        if (k % 5 == 4) walk.fix_one(twin);
        const Values<SE3d> before = twin.smoother.values();
        REQUIRE(twin.smoother.update().ok());
        CHECK(largest_difference(twin.smoother.values(), gauss_newton_step(twin.graph(before))) < 1e-7);
      }
    });
  }

  TEST_CASE("after converge, the estimate is the batch optimum, whatever came and went") {
    for_all(20, [](Rng& rng, int size) {
      Twin twin;
      Walk walk(rng);
      for (int k = 0; k < 4 + size / 2; ++k) {
        walk.step(twin);
        if (k % 5 == 3) walk.remove_one(twin);
        if (k % 7 == 6) walk.fix_one(twin);
        REQUIRE(twin.smoother.update().ok());
        if (k % 8 != 7) continue;
        const ConvergeReport report = twin.smoother.converge();
        REQUIRE(report.ok());
        Graph graph = twin.graph(twin.smoother.values());
        REQUIRE(optimize(graph).ok());
        CHECK(twin.smoother.cost() == doctest::Approx(graph.cost()).epsilon(1e-6));
        CHECK(largest_difference(twin.smoother.values(), graph.values()) < 1e-4);
      }
    });
  }

  TEST_CASE("the cost that is kept is the one that is computed, whatever comes, goes, moves, or is undone") {
    for_all(20, [](Rng& rng, int size) {
      Twin twin;
      Walk walk(rng);
      const auto check = [&] {
        const double cost = twin.smoother.cost();
        CHECK(twin.smoother.current_cost() == doctest::Approx(cost).epsilon(1e-9).scale(1));
      };
      for (int k = 0; k < 6 + size / 2; ++k) {
        walk.step(twin);
        const bool asks = k % 3 != 1;
        if (asks) check();
        if (k % 5 == 3) walk.remove_one(twin);
        if (k % 7 == 6) walk.fix_one(twin);
        if (k % 4 == 2) {
          const FactorId id = twin.smoother.add(twin.betweens.front());
          twin.smoother.set_weight(id, 0.3);
        }
        if (asks) check();
        REQUIRE(twin.smoother.update().ok());
        check();
        if (k % 6 == 5) twin.smoother.move(std::vector<Key>{0, 1}, SE3d(SO3d(), {0.1, 0, 0}));
        check();
        if (k % 8 == 7) REQUIRE(twin.smoother.converge().ok());
        check();
      }
      walk.step(twin);
      REQUIRE(twin.smoother.update().ok());
      check();
      twin.smoother.undo();
      check();
    });
  }

  TEST_CASE("undo brings back every bit, and leads on to the same bits") {
    for_all(20, [](Rng& rng, int size) {
      Rng other_rng = rng;
      Twin twin;
      Twin other;
      Walk walk(rng);
      Walk other_walk(other_rng);
      for (int k = 0; k < 3 + size / 4; ++k) {
        walk.step(twin);
        other_walk.step(other);
        REQUIRE(twin.smoother.update().ok());
        REQUIRE(other.smoother.update().ok());
      }
      const Values<SE3d> before = twin.smoother.values();
      for (int k = 0; k < 5; ++k) walk.step(twin);
      walk.remove_one(twin);
      REQUIRE(twin.smoother.update().ok());
      twin.smoother.undo();
      CHECK(twin.smoother.values() == before);
      for (int k = 0; k < 3; ++k) {
        twin.smoother.add_value(before[0]);
        twin.smoother.add_between(0, twin.smoother.size() - 1, SE3d(), Smoother::Noise::from_sigma(0.1));
        other.smoother.add_value(before[0]);
        other.smoother.add_between(0, other.smoother.size() - 1, SE3d(), Smoother::Noise::from_sigma(0.1));
        REQUIRE(twin.smoother.update().ok());
        REQUIRE(other.smoother.update().ok());
        CHECK(twin.smoother.values() == other.smoother.values());
      }
    });
  }

  TEST_CASE("an update that fails says why, and leaves all as it was") {
    Smoother smoother;
    const auto noise = Smoother::Noise::from_sigma(0.1);
    for (Key key = 0; key < 10; ++key) {
      smoother.add_value(SE3d());
      if (key == 0) smoother.add_prior(0, SE3d(), noise);
      if (key > 0) smoother.add_between(key - 1, key, SE3d::exp(Vector6d::Constant(0.1)), noise);
    }
    const FactorId closure = smoother.add_between(2, 7, SE3d::exp(Vector6d::Constant(0.4)), noise);
    REQUIRE(smoother.update().ok());
    const Values<SE3d> before = smoother.values();
    const auto unchanged = [&] {
      CHECK(smoother.size() == 10);
      CHECK(smoother.factor_count() == 11);
      CHECK(smoother.values() == before);
      CHECK(smoother.contains(closure));
    };

    SUBCASE("parts that nothing holds, by their least keys") {
      for (int k = 0; k < 5; ++k) smoother.add_value(SE3d());  // 10 .. 14
      smoother.add_between(12, 11, SE3d(), noise);
      smoother.add_between(14, 12, SE3d(), noise);
      smoother.remove(closure);
      const UpdateReport report = smoother.update();
      CHECK(report.status == UpdateStatus::unconstrained);
      CHECK(report.variables == std::vector<Key>{10, 11, 13});
      REQUIRE(report.free.size() == 3);
      CHECK(describe(report.free[0]) == "variable 10 is free in translation, rotation (6 directions)");
      CHECK(describe(report.free[1]) == "variable 11 (3 variables) is free in translation, rotation (6 directions)");
      unchanged();
    }
    SUBCASE("a direction that is not measured") {
      smoother.add_value(SE3d());
      Vector6d sigmas = Vector6d::Ones();
      sigmas[5] = std::numeric_limits<double>::infinity();  // no yaw
      smoother.add_between(3, 10, SE3d(), Smoother::Noise::from_sigmas(sigmas));
      const UpdateReport report = smoother.update();
      CHECK(report.status == UpdateStatus::singular);
      CHECK(report.variables == std::vector<Key>{10});
      REQUIRE(report.free.size() == 1);
      CHECK(report.free[0].key == 10);
      REQUIRE(report.free[0].directions.cols() == 1);
      CHECK(std::abs(report.free[0].directions(5, 0)) > 0.9);
      unchanged();
    }
    SUBCASE("a measurement that is not a number") {
      smoother.add_value(SE3d());
      const SE3d nowhere(SO3d(), Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN()));
      smoother.add_between(3, 10, nowhere, noise);
      const UpdateReport report = smoother.update();
      CHECK(report.status == UpdateStatus::not_finite);
      CHECK(report.variables == std::vector<Key>{3, 10});
      unchanged();
    }
    smoother.add_value(SE3d());
    const FactorId next = smoother.add_between(9, 10, SE3d(), noise);
    smoother.remove(closure);
    REQUIRE(smoother.update().ok());
    CHECK(!smoother.contains(closure));
    CHECK(smoother.contains(next));
    CHECK_THROWS_AS(smoother.remove(closure), std::invalid_argument);
    // without the closure the chain is exact
    CHECK(smoother[9].local(smoother[10]).norm() < 1e-9);
  }

  TEST_CASE("a caller's mistakes are refused at the door") {
    Smoother smoother;
    smoother.add_value(SE3d());
    const auto noise = Smoother::Noise::from_sigma(0.1);
    CHECK_THROWS_AS(smoother.add_between(0, 1, SE3d(), noise), std::invalid_argument);
    CHECK_THROWS_AS(smoother.add_between(0, 0, SE3d(), noise), std::invalid_argument);
    CHECK_THROWS_AS(smoother.remove(FactorId{}), std::invalid_argument);
    CHECK_THROWS_AS(smoother.set_fixed(3), std::invalid_argument);
  }

  TEST_CASE("only what a closure moves is reported as changed") {
    Smoother smoother;
    const auto noise = Smoother::Noise::from_sigma(0.01);
    for (Key key = 0; key < 400; ++key) {
      smoother.add_value(SE3d(SO3d(), {key * 1.0, 0, 0}));
      if (key == 0) smoother.add_prior(0, SE3d(), noise);
      if (key > 0) smoother.add_between(key - 1, key, SE3d(SO3d(), {1, 0, 0}), noise);
      REQUIRE(smoother.update().ok());
    }
    smoother.add_between(390, 395, SE3d(SO3d(), {5.1, 0, 0}), noise);
    REQUIRE(smoother.update().ok());
    const std::vector<Key> changed(smoother.changed().begin(), smoother.changed().end());
    CHECK(!changed.empty());
    CHECK(*std::min_element(changed.begin(), changed.end()) >= 380);
  }

  TEST_CASE("what moves as a whole is not linearized anew") {
    Smoother smoother;
    const auto noise = Smoother::Noise::from_sigma(1e-5);
    const auto weak = Smoother::Noise::from_sigma(50.0);
    for (Key key = 0; key < 600; ++key) {
      const bool second = key >= 300;  // a session that starts somewhere
      const SE3d start = second ? SE3d::exp((Vector6d() << 40, -25, 1, 0, 0, 0.5).finished()) : SE3d();
      smoother.add_value(start * SE3d(SO3d(), {key % 300 * 1.0, 0, 0}));
      if (key % 300 == 0) smoother.add_prior(key, start, second ? weak : noise);
      if (key % 300 > 0) smoother.add_between(key - 1, key, SE3d(SO3d(), {1, 0, 0}), noise);
      REQUIRE(smoother.update().ok());
    }
    smoother.add_between(100, 400, SE3d(SO3d(), {0, 2, 0}), noise);
    Index relinearized = 0;
    for (int k = 0; k < 5; ++k) {
      const UpdateReport report = smoother.update();
      REQUIRE(report.ok());
      relinearized += report.relinearized;
    }
    CHECK(smoother[400].local(SE3d(SO3d(), {100, 2, 0})).norm() < 1e-3);
    CHECK(smoother[599].local(SE3d(SO3d(), {299, 2, 0})).norm() < 1e-2);
    CHECK(relinearized < 700);
    const double before = smoother.cost();
    REQUIRE(smoother.converge().ok());
    CHECK(before <= 1.0001 * smoother.cost());
  }

  TEST_CASE("chains of 100 000 poses are no deeper than memory") {
    Smoother smoother;
    const auto noise = Smoother::Noise::from_sigma(0.01);
    for (Key key = 0; key < 100000; ++key) {
      smoother.add_value(SE3d(SO3d(), {key * 1.0, 0, 0}));
      if (key == 0) smoother.add_prior(0, SE3d(), noise);
      if (key > 0) smoother.add_between(key - 1, key, SE3d(SO3d(), {1, 0, 0}), noise);
    }
    REQUIRE(smoother.update().ok());
    smoother.add_between(0, 99999, SE3d(SO3d(), {99999, 1, 0}), noise);
    REQUIRE(smoother.update().ok());
    REQUIRE(smoother.update().ok());
    CHECK(std::isfinite(smoother.cost()));
  }

  TEST_CASE("fed pose by pose, a real graph ends within 1e-4 of its optimum, and converges to it" *
            doctest::skip(quick())) {
    const auto path = real_data("pose_graphs/parking-garage.g2o");
    if (!path) return;
    constexpr double optimum = 1.2683848;  // from shared/data/pose_graphs/README.md
    Smoother smoother = fed(make_graph(read_g2o(*path).spatial), {}, true);
    CHECK(smoother.cost() <= 1.0001 * optimum);
    CHECK(smoother.cost() >= 0.9999999 * optimum);
    REQUIRE(smoother.converge().ok());
    CHECK(smoother.cost() == doctest::Approx(optimum).epsilon(1e-6));
  }

  TEST_CASE("the same calls give the same bits") {
    Rng rng(7);
    const FactorGraph<SE3d> graph = random_graph<SE3d>(rng, 120, 0.05);
    const Smoother one = fed(graph, {}, true);
    const Smoother other = fed(graph, {}, true);
    CHECK(one.values() == other.values());
  }

  TEST_CASE("any number of threads gives the same bits") {
    Rng rng(9);
    const FactorGraph<SE3d> graph = random_graph<SE3d>(rng, 250, 0.05);
    const auto converged = [&](const auto& executor) {
      Smoother smoother;
      smoother.append(graph);
      smoother.set_fixed(0);
      const UpdateReport first = smoother.update(executor);
      REQUIRE(first.ok());
      CHECK(first.work.multiplications > IncrementalCholesky<6>::Options{}.least_shared_work);  // shared out at all
      const ConvergeReport report = smoother.converge({}, executor);
      CHECK(report.converged);
      return std::pair(smoother.values(), report.final_cost);
    };
    const auto expected = converged(Serial{});
    for (const Index threads : {1, 2, 4}) CHECK(converged(ThreadPool(threads)) == expected);
  }

  TEST_CASE("planar graphs, too") {
    Rng rng(8);
    FactorGraph<SE2d> graph = random_graph<SE2d>(rng, 150, 0.05);
    auto smoother = fed<IncrementalSmoother<SE2d>>(graph, {}, true);
    graph.set_fixed(0);
    REQUIRE(optimize(graph).ok());
    CHECK(smoother.cost() <= 1.0001 * graph.cost());
    REQUIRE(smoother.converge().ok());
    CHECK(smoother.cost() == doctest::Approx(graph.cost()).epsilon(1e-7));
  }

  TEST_CASE("where full steps end in the wrong place, converge starts again from the chordal relaxation") {
    constexpr int size = 12;
    const SE2d step(SO2d::from_angle(2 * std::numbers::pi / size), {1, 0});
    for (const bool restart : {false, true}) {
      IncrementalSmoother<SE2d> smoother;
      for (int k = 0; k < size; ++k) smoother.add_value(SE2d());  // a ring, wound the wrong way
      for (int k = 0; k < size; ++k)
        smoother.add_between(k, (k + 1) % size, step, NoiseModel<3>::from_sigmas({0.1, 0.1, 0.1}));
      smoother.set_fixed(0);
      const ConvergeReport report = restart ? smoother.converge() : smoother.converge(ConvergeOptions<NoRestart>{});
      REQUIRE(report.ok());
      CHECK(report.converged);
      CHECK(report.final_cost == doctest::Approx(smoother.cost()).epsilon(1e-9).scale(1));
      CHECK(report.final_cost <= report.initial_cost);
      CHECK((report.final_cost < 1e-9) == restart);
      CHECK((report.method == ConvergeMethod::chordal_restart) == restart);
      smoother.add_value(smoother[size - 1]);  // and goes on from there
      smoother.add_between(size - 1, size, step, NoiseModel<3>::from_sigma(0.1));
      REQUIRE(smoother.update().ok());
      CHECK(smoother[size].local(smoother[size - 1] * step).norm() < 1e-6);
    }
  }

  TEST_CASE("from far away, converge takes about as many steps as the batch optimizer, and knows where they end") {
    PoseGraph graph = StreetWalk({.sessions = 1, .keyframes = 200, .blocks = 2}).graph();
    Rng rng(7);
    Values<SE3d> far = graph.values();
    for (Key key = 1; key < far.size(); ++key) far[key] = far[key].retract(random_tangent<SE3d>(rng, 100.0, 0.4));
    graph.set_values(far);
    IncrementalSmoother<SE3d> smoother;
    for (const SE3d& pose : far) smoother.add_value(pose);
    graph.for_each_factor([&](const auto& factor) { smoother.add(factor); });
    smoother.set_fixed(0);
    const OptimizeReport batch = optimize(graph, LevenbergMarquardt{.max_iterations = 200});
    REQUIRE(batch.status == OptimizeStatus::converged);
    const ConvergeReport report = smoother.converge(ConvergeOptions<NoRestart>{.max_iterations = 50});
    CHECK(report.converged);
    CHECK(report.final_cost == doctest::Approx(batch.final_cost));
    CHECK(report.iterations <= batch.iterations + 3);
  }

  TEST_CASE("converge never raises the cost, wherever the estimate starts") {
    for_all(20, [](Rng& rng, int size) {
      FactorGraph<SE2d> graph = random_graph<SE2d>(rng, size + 10, 0.05);
      IncrementalSmoother<SE2d> smoother;
      for (Key key = 0; key < graph.values().size(); ++key)
        smoother.add_value(key == 0 ? graph[0] : graph[key].retract(random_tangent<SE2d>(rng, 5.0, 1.5)));
      for (const auto& factor : graph.betweens()) smoother.add(factor);
      smoother.set_fixed(0);
      graph.set_fixed(0);
      REQUIRE(optimize(graph).ok());
      const ConvergeReport report =
          size % 2 == 0 ? smoother.converge() : smoother.converge(ConvergeOptions<NoRestart>{});
      REQUIRE(report.ok());
      CHECK(report.final_cost <= report.initial_cost);
      CHECK(report.final_cost == doctest::Approx(smoother.cost()));
      if (size % 2 == 0) CHECK(report.final_cost <= (1 + 1e-6) * graph.cost());
    });
  }
}
