#include <doctest/doctest.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "chainslam/factor_graph/batch_optimizer.hpp"
#include "chainslam/factor_graph/factors.hpp"
#include "chainslam/factor_graph/incremental_gnc.hpp"
#include "chainslam/factor_graph/incremental_smoother.hpp"
#include "chainslam/factor_graph/marginals.hpp"
#include "chainslam/lie/rn.hpp"
#include "factor_graph/smoother_twin.hpp"
#include "support/property.hpp"
#include "support/quick.hpp"
#include "support/street_walk.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

/// How the parts of a chain of poses can move that only some factors on single poses hold.
template <class... Factors>
std::string freedom_of_chain(const Values<SE3d>& values, const Factors&... factors) {
  detail::HeldComponents<SE3d> components;
  for (Key key = 0; key < values.size(); ++key) components.add_variable();
  [[maybe_unused]] const auto hold = [&](const auto& factor) {
    const auto numbers = detail::linearization(factor, values, detail::Kernels::applied);
    components.hold(factor.keys(), factor.rows, numbers.data(), values, 0);
  };
  (hold(factors), ...);
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
      return GravityFactor<>{key, S2<double>::from_vector(values[key].rotation().inverse() * Eigen::Vector3d::UnitZ()),
                             0.01};
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

  TEST_CASE("what floats is known after any additions, removals and moves: as if all were put together again") {
    for_all(60, [](Rng& rng, int) {
      Smoother smoother;
      std::vector<FactorId> ids;
      const auto any_key = [&] { return static_cast<Key>(rng.uniform_index(smoother.size())); };
      const auto noise = Smoother::Noise::from_sigma(0.1);
      Vector6d sigmas = Vector6d::Constant(0.1);
      sigmas.tail<3>().setConstant(std::numeric_limits<double>::infinity());
      const auto hold = [&](Key key, bool position_only) {
        const auto of_prior = position_only ? Smoother::Noise::from_sigmas(sigmas) : noise;
        ids.push_back(smoother.add_prior(key, smoother[key], of_prior));
      };
      for (Key key = 0; key < 8; ++key) {
        smoother.add_value(random_pose<SE3d>(rng));
        if (key > 0) ids.push_back(smoother.add_between(key - 1, key, SE3d(), noise));
      }
      for (int step = 0; step < 100; ++step) {
        const auto action = rng.uniform_index(10);
        const Key a = any_key(), b = any_key();
        if (action == 0) smoother.add_value(random_pose<SE3d>(rng));
        if (action < 3 && a != b) ids.push_back(smoother.add_between(a, b, SE3d(), noise));
        if (action == 3) hold(a, false);
        if (action == 4) hold(a, true);
        if (action >= 5 && action < 8 && !ids.empty()) {
          const Index k = rng.uniform_index(to_index(ids.size()));
          smoother.remove(ids[static_cast<std::size_t>(k)]);
          ids.erase(ids.begin() + k);
        }
        if (action == 8) smoother.move(std::array{a, b}, random_pose<SE3d>(rng));
        if (action == 9 && step % 4 == 0) smoother.set_fixed(a, !smoother.is_fixed(a));
        Smoother again;
        for (Key key = 0; key < smoother.size(); ++key) again.add_value(smoother[key]);
        for (Key key = 0; key < smoother.size(); ++key) again.set_fixed(key, smoother.is_fixed(key));
        smoother.for_each_factor([&](const auto& factor) { again.add(factor); });
        const std::vector<Key> floating = smoother.floating();
        CHECK(floating == again.floating());
        // Mostly nothing floats, as in a map; what holds it is often just enough, and several together.
        for (int k = 0; k < 10 && !smoother.floating().empty(); ++k)
          hold(k < 9 ? any_key() : smoother.floating().front(), k < 9);
      }
    });
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
    Graph graph;
    for (Key key = 0; key < 9; ++key) graph.add_value(smoother[key]);
    const UpdateReport report = smoother.update();
    CHECK(report.status == UpdateStatus::singular);
    REQUIRE(report.free.size() == 1);
    CHECK(describe(report.free[0]).starts_with("variable 4 (5 variables) is free in z (1 direction"));
    graph.add_prior(0, SE3d(), noise);
    for (Key key = 1; key < 9; ++key)
      graph.add_between(key - 1, key, SE3d(SO3d(), {1, 0, 0}), key == 4 ? Smoother::Noise::from_sigmas(sigmas) : noise);
    const OptimizeReport batch = optimize(graph, GaussNewton{});
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
      const Graph graph = twin.graph(twin.smoother.values());
      detail::NormalEquations<Graph> equations(graph);
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

  TEST_CASE("what factors would lower the squared error by, if they were taken out together, is what they do") {
    for_all(20, [](Rng& rng, int size) {
      Twin twin;
      Walk walk(rng);
      for (int k = 0; k < 5 + size; ++k) walk.step(twin);
      REQUIRE(twin.smoother.converge().ok());
      const Key last = twin.smoother.size() - 1;
      std::vector<BetweenFactor<SE3d>> added;
      std::vector<FactorId> ids;
      for (const Key from : {0, 1}) {
        BetweenFactor<SE3d> factor{from, last, twin.smoother[from].inverse() * twin.smoother[last], {}};
        factor.measurement = factor.measurement * SE3d::exp(random_tangent<SE3d>(rng, 0.003, 0.003));
        factor.sqrt_information = Smoother::Noise::from_sigma(0.02).sqrt_information();
        added.push_back(factor);
      }
      const double without = twin.smoother.cost();
      const double rise = twin.smoother.rise_with(std::span<const BetweenFactor<SE3d>>(added)).change;
      for (const auto& factor : added) ids.push_back(twin.smoother.add(factor));
      REQUIRE(twin.smoother.converge().ok());
      // kernels and curvature are not in the forecasts
      CHECK(twin.smoother.cost() - without == doctest::Approx(rise).epsilon(0.05).scale(0.1));
      const double fall = twin.smoother.fall_without(std::span<const BetweenFactor<SE3d>>(added)).change;
      CHECK(twin.smoother.cost() - without == doctest::Approx(fall).epsilon(0.05).scale(0.1));
    });
  }

  TEST_CASE("a forecast bounds those of later graphs that know more, until the smoother counts a loss") {
    for_all(20, [](Rng& rng, int size) {
      Twin twin;
      Walk walk(rng);
      for (int k = 0; k < 5 + size; ++k) walk.step(twin);
      const Key last = twin.smoother.size() - 1;
      const auto between = [&](Key from, Key to) {
        BetweenFactor<SE3d> factor{from, to, twin.smoother[from].inverse() * twin.smoother[to], {}};
        factor.measurement = factor.measurement * SE3d::exp(random_tangent<SE3d>(rng, 0.003, 0.003));
        factor.sqrt_information = Smoother::Noise::from_sigma(0.02).sqrt_information();
        return factor;
      };
      const std::vector<BetweenFactor<SE3d>> in{between(0, last), between(1, last)}, out{between(2, last)};
      for (const auto& factor : in) twin.smoother.add(factor);
      REQUIRE(twin.smoother.converge().ok());
      const JointForecast fall = twin.smoother.fall_without(std::span(in)),
                          rise = twin.smoother.rise_with(std::span(out));
      const std::uint64_t losses = twin.smoother.losses();
      const FactorId more = twin.smoother.add(between(3, last), 0.5);
      twin.smoother.set_weight(more, 1.0);
      REQUIRE(twin.smoother.converge().ok());
      CHECK(twin.smoother.losses() == losses);
      const auto squares = [&](const std::vector<BetweenFactor<SE3d>>& factors) {
        double sum = 0;
        for (const auto& factor : factors) sum += factor.residual(twin.smoother.values()).squaredNorm();
        return sum;
      };
      constexpr double curvature = 1.001;
      CHECK(twin.smoother.fall_without(std::span(in)).change <= curvature * fall.per_residual * squares(in));
      CHECK(curvature * twin.smoother.rise_with(std::span(out)).change >= rise.per_residual * squares(out));
      CHECK(fall.per_residual > 1.0);
      CHECK(rise.per_residual < 1.0);
      twin.smoother.set_weight(more, 0.5);
      CHECK(twin.smoother.losses() > losses);
      const std::uint64_t weighed = twin.smoother.losses();
      twin.smoother.remove(more);
      CHECK(twin.smoother.losses() > weighed);
    });
  }

  TEST_CASE("what alone holds a variable has no fall") {
    Twin twin;
    Rng rng(1);
    Walk walk(rng);
    for (int k = 0; k < 8; ++k) walk.step(twin);
    const SE3d beside = SE3d::exp((Vector6d() << 1, 0, 0, 0, 0, 0.1).finished());
    const Key free = twin.smoother.add_value(twin.smoother[1] * beside);
    const BetweenFactor<SE3d> only{1, free, beside, Smoother::Noise::from_sigma(0.1).sqrt_information()};
    twin.smoother.add(only);
    REQUIRE(twin.smoother.converge().ok());
    const JointForecast fall = twin.smoother.fall_without(std::span<const BetweenFactor<SE3d>>(&only, 1));
    CHECK_FALSE(fall.change > 1e-3);
    CHECK_FALSE(fall.per_residual < 1e9);  // bounds nothing
  }

  TEST_CASE("the covariance of a relative pose is that of both poses, carried") {
    for_all(10, [](Rng& rng, int size) {
      Twin twin;
      Walk walk(rng);
      for (int k = 0; k < 5 + size; ++k) walk.step(twin);
      REQUIRE(twin.smoother.converge().ok());
      const Key last = twin.smoother.size() - 1;
      const std::vector<Key> keys{1, last};
      Eigen::Matrix<double, 6, 12> J;
      J << -(twin.smoother[last].inverse() * twin.smoother[1]).adjoint(), Matrix6d::Identity();
      const Matrix6d expected = J * twin.smoother.covariance(keys) * J.transpose();
      CHECK((twin.smoother.relative_covariance(1, last) - expected).norm() < 1e-9 * expected.norm());
      CHECK(twin.smoother.relative_covariance(last, last).isZero(0));
      twin.smoother.set_fixed(1);
      REQUIRE(twin.smoother.update().ok());
      CHECK((twin.smoother.relative_covariance(1, last) - twin.smoother.covariance(last)).norm() <
            1e-9 * expected.norm());
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
    Graph graph = twin.graph(twin.smoother.values());
    REQUIRE(optimize(graph).ok());
    CHECK(twin.smoother.cost() == doctest::Approx(graph.cost()).epsilon(1e-6));
    CHECK(largest_difference(twin.smoother.values(), graph.values()) < 1e-3);
    CHECK_THROWS_AS(twin.smoother.move(std::vector<Key>{400}, offset), std::invalid_argument);
  }

  TEST_CASE("a move can be undone before and after its update, until that is committed") {
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

    twin.smoother.move(keys, random_pose<SE3d>(rng));
    REQUIRE(twin.smoother.update().ok());
    const Values<SE3d> moved = twin.smoother.values();
    CHECK(!(moved == before));
    twin.smoother.commit();
    twin.smoother.undo();
    CHECK(twin.smoother.values() == moved);
    twin.smoother.move(keys, random_pose<SE3d>(rng));
    twin.smoother.commit();  // not what awaits an update
    twin.smoother.undo();
    CHECK(twin.smoother.values() == moved);
  }

  TEST_CASE("what was saved goes on to the same bits, with the same names of factors") {
    for_all(12, [](Rng& rng, int size) {
      Twin twin;
      Walk walk(rng);
      for (int k = 0; k < 6 + size; ++k) {
        walk.step(twin);
        if (k % 5 == 4) walk.remove_one(twin);
        if (k % 7 == 6) walk.fix_one(twin);
        REQUIRE(twin.smoother.update().ok());
      }
      if (size % 3 == 0) twin.smoother.undo();
      const std::vector<std::byte> saved = twin.smoother.save();
      Smoother other = Smoother::load(saved);
      CHECK(other.save() == saved);
      CHECK(other.values() == twin.smoother.values());
      CHECK(other.cost() == twin.smoother.cost());
      CHECK(other.factor_count() == twin.smoother.factor_count());
      const auto noise = Smoother::Noise::from_sigma(0.02);
      for (int k = 0; k < 8; ++k) {
        const Key last = other.size() - 1;
        for (Smoother* const smoother : {&twin.smoother, &other}) {
          smoother->add_value((*smoother)[last]);
          const FactorId id = smoother->add_between(last, last + 1, SE3d::exp(Vector6d::Constant(0.1)), noise);
          if (k == 3) smoother->add_between(1, last, SE3d::exp(Vector6d::Constant(0.3)), noise);
          if (k == 5 && !twin.closures.empty() && smoother->contains(twin.closures.front().first))
            smoother->remove(twin.closures.front().first);
          const UpdateReport report = smoother->update();
          REQUIRE(report.ok());
          CHECK(smoother->contains(id));
        }
        CHECK(other.values() == twin.smoother.values());
      }
      CHECK(other.save() == twin.smoother.save());
      CHECK(twin.smoother.converge().final_cost == other.converge().final_cost);
      CHECK(other.values() == twin.smoother.values());
    });
  }

  TEST_CASE("what is not a whole saved smoother is refused by its byte, and so are open changes") {
    Rng rng(3);
    Twin twin;
    Walk walk(rng);
    for (int k = 0; k < 6; ++k) walk.step(twin);
    CHECK_THROWS_AS(static_cast<void>(twin.smoother.save()), std::invalid_argument);
    REQUIRE(twin.smoother.update().ok());
    const std::vector<std::byte> saved = twin.smoother.save();
    const auto refused = [](std::vector<std::byte> bytes) -> std::string {
      try {
        static_cast<void>(Smoother::load(bytes, "it"));
      } catch (const IoError& error) {
        return error.report().place;
      }
      return "";
    };
    for (std::size_t length = 0; length < saved.size(); length += 97)
      CHECK(refused({saved.begin(), saved.begin() + static_cast<std::ptrdiff_t>(length)}).starts_with("byte "));
    for (std::size_t at = 0; at < saved.size(); at += 61) {
      std::vector<std::byte> bytes = saved;
      bytes[at] ^= std::byte{4};
      CHECK(refused(bytes).starts_with("byte "));
    }
    CHECK(refused(std::vector<std::byte>(100, std::byte{7})) == "byte 0");
    std::vector<std::byte> later = saved;
    later[8] = static_cast<std::byte>(detail::state_version + 1);
    CHECK(refused(later) == "byte 8");
    CHECK_THROWS_AS(static_cast<void>(IncrementalSmoother<SE2d>::load(saved)), IoError);
    CHECK(refused(saved).empty());
  }

  TEST_CASE("a marginalized variable leaves the Schur complement of what was said of it") {
    for_all(20, [](Rng& rng, int size) {
      FactorGraph<SE3d> graph = random_graph<SE3d>(rng, 6, 0.05);
      detail::DenseElimination elimination(6, 2, {0, 1, 3, 4, 5});
      if (size % 2 == 0) graph.add_prior(0, graph[0], random_noise<6>(rng));
      graph.for_each_factor([&](const auto& factor) {
        const auto numbers = detail::linearization(factor, graph.values(), detail::Kernels::applied);
        elimination.add(factor.keys(), factor.rows, numbers.data());
      });
      const std::vector<SE3d> points{graph[0], graph[1], graph[3], graph[4], graph[5]};
      const auto left = elimination.eliminate(true);
      const LinearPrior<SE3d> prior{{0, 1, 3, 4, 5}, points, left.sqrt_information, left.offset};
      detail::NormalEquations<FactorGraph<SE3d>> equations(graph);
      const double cost = equations.linearize(graph, graph.values());
      Eigen::MatrixXd H(36, 36);
      for (Eigen::Index k = 0; k < 36; ++k) H.col(k) = equations.matrix() * Eigen::VectorXd::Unit(36, k);
      Eigen::VectorXd g = equations.gradient();
      Eigen::PermutationMatrix<36> order;
      order.indices() << 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 0, 1, 2, 3, 4, 5, 18, 19, 20, 21, 22, 23, 24, 25,
          26, 27, 28, 29, 30, 31, 32, 33, 34, 35;
      H = order * H * order.transpose();
      g = order * g;
      const Eigen::LLT<Matrix6d> own(H.topLeftCorner<6, 6>());
      const Eigen::MatrixXd coupling = H.bottomLeftCorner(30, 6);
      const Eigen::MatrixXd schur = H.bottomRightCorner(30, 30) - coupling * own.solve(coupling.transpose());
      const Eigen::VectorXd gradient = g.tail(30) - coupling * own.solve(g.head<6>());
      const Eigen::MatrixXd& R = prior.sqrt_information;
      CHECK((R.transpose() * R - schur).norm() < 1e-10 * H.norm());
      CHECK((R.transpose() * prior.offset - gradient).norm() < 1e-8 * (1.0 + g.norm()));
      CHECK(prior.offset.squaredNorm() == doctest::Approx(cost - g.head<6>().dot(own.solve(g.head<6>()))));
      CHECK(R.rows() == (size % 2 == 0 ? 31 : 25));  // and the row of what cannot be lowered
      Values<SE3d> away = graph.values();
      for (const Key key : prior.keys()) away[key] = away[key].retract(random_tangent<SE3d>(rng, 0.5, 0.3));
      const auto linearized = prior.linearize(away);
      const Vector6d step = random_tangent<SE3d>(rng, 1e-6, 1e-6);
      Values<SE3d> moved = away;
      moved[3] = moved[3].retract(step);
      CHECK((linearized.residual - prior.residual(away)).norm() == 0.0);
      CHECK((prior.residual(moved) - linearized.residual - linearized.jacobians[2] * step).norm() < 1e-7);
    });
  }

  TEST_CASE("with a lag, linear problems keep the batch's estimates, and names stay good") {
    using Point = R2d;
    for_all(10, [](Rng& rng, int size) {
      SmootherOptions options = exact;
      options.lag = 6;
      IncrementalSmoother<Point> smoother(options);
      IncrementalSmoother<Point> whole(exact);
      std::vector<FactorId> names;
      const auto noise = [&] { return NoiseModel<2>::from_sigma(0.1 + rng.uniform()); };
      for (Key key = 0; key < 15 + size; ++key) {
        const Point measured(Eigen::Vector2d(rng.normal(), rng.normal()));
        const Key from = std::max(0, key - 1 - rng.uniform_index(4));
        const auto one = noise(), other = noise();
        for (auto* const each : {&smoother, &whole}) {
          each->add_value(Point());
          if (key == 0) each->add_prior(0, measured, one);
          if (key > 0) each->add_between(key - 1, key, measured, one);
          if (from < key - 1) {
            const FactorId id = each->add_between(from, key, measured * measured, other);
            if (each == &smoother) names.push_back(id);
          }
          REQUIRE(each->update().ok());
        }
        if (from < key - 1) CHECK(smoother.contains(names.back()));
        CHECK(smoother.cost() == doctest::Approx(whole.cost()).epsilon(1e-9));
        for (Key kept = std::max(0, key - 5); kept <= key; ++kept) {
          CHECK((smoother[kept].value() - whole[kept].value()).norm() < 1e-9);
          CHECK(!smoother.is_marginalized(kept));
          CHECK((smoother.covariance(kept) - whole.covariance(kept)).norm() < 1e-9);
        }
        CHECK(smoother.factor_count() < 30);
      }
      CHECK(smoother.is_marginalized(1));
      CHECK(smoother.count<LinearPrior<Point>>() > 0);
      for (std::size_t k = 0; k < names.size(); ++k) CHECK((!smoother.contains(names[k]) || k + 6 >= names.size()));
      CHECK_THROWS_AS(smoother.add_between(1, smoother.size() - 1, Point(), noise()), std::invalid_argument);
      CHECK_THROWS_AS(smoother.set_fixed(1, false), std::invalid_argument);
    });
  }

  TEST_CASE("a smoother without a lag takes no options that set one") {
    CHECK_THROWS_AS(Smoother({.lag = 1}, NoLag{}), std::invalid_argument);
    CHECK(Smoother(SmootherOptions{}, NoLag{}).size() == 0);
  }

  TEST_CASE("with a lag, neither work nor memory grows, however long the way") {
    Rng rng(6);
    Smoother smoother({.lag = 30});
    const auto noise = Smoother::Noise::from_sigma(0.02);
    Index most_before = 0, most_after = 0;
    Offset bytes_before = 0;
    for (Key key = 0; key < 900; ++key) {
      const SE3d step = SE3d::exp(random_tangent<SE3d>(rng, 0.5, 0.1));
      smoother.add_value(key == 0 ? SE3d() : smoother[key - 1] * step);
      if (key == 0) smoother.add_prior(0, SE3d(), noise);
      if (key > 0) smoother.add_between(key - 1, key, step, noise);
      if (key > 40 && key % 4 == 0) {
        const Key other = key - 5 - rng.uniform_index(20);
        smoother.add_between(other, key, smoother[other].inverse() * smoother[key], noise);
      }
      const UpdateReport report = smoother.update();
      REQUIRE(report.ok());
      Index& most = key < 300 ? most_before : most_after;
      most = std::max(most, report.work.refactorized);
      if (key == 300) bytes_before = smoother.solver().tree().bytes();
    }
    CHECK(most_after <= 2 * most_before);
    CHECK(most_after < 80);
    CHECK(smoother.solver().tree().bytes() == bytes_before);
    CHECK(smoother.factor_count() < 60);
  }

  TEST_CASE("poses given up leave the optimum of the others, can be brought back, and are saved") {
    Rng rng(4);
    Twin twin;
    Walk walk(rng);
    for (int k = 0; k < 40; ++k) walk.step(twin);
    REQUIRE(twin.smoother.converge().ok());
    const Values<SE3d> before = twin.smoother.values();
    const double error = twin.smoother.update().squared_error;
    std::vector<Key> old;
    for (Key key = 0; key < 20; ++key) old.push_back(key);
    twin.smoother.marginalize(old);
    const UpdateReport report = twin.smoother.update();
    REQUIRE(report.ok());
    CHECK(report.squared_error == doctest::Approx(error).epsilon(1e-3));
    CHECK(largest_difference(twin.smoother.values(), before) < 1e-4);
    CHECK(twin.smoother.floating().empty());
    Smoother other = Smoother::load(twin.smoother.save());
    for (Smoother* const smoother : {&twin.smoother, &other}) {
      smoother->add_value(before[39]);
      smoother->add_between(39, 40, SE3d::exp(Vector6d::Constant(0.1)), Smoother::Noise::from_sigma(0.02));
      REQUIRE(smoother->update().ok());
      REQUIRE(smoother->converge().ok());
    }
    CHECK(other.values() == twin.smoother.values());
    other.undo();
    twin.smoother.undo();
    CHECK(other.values() == twin.smoother.values());
  }

  TEST_CASE("a factor of weight 0 is as one that is not there, and comes back with its name") {
    Rng rng(9);
    Smoother smoother(exact);
    const FactorGraph<SE3d> graph = random_graph<SE3d>(rng, 20, 0.05);
    for (const SE3d& value : graph.values()) smoother.add_value(value);
    smoother.set_fixed(0);
    std::vector<FactorId> names;
    for (const auto& factor : graph.betweens()) names.push_back(smoother.add(factor));
    REQUIRE(smoother.converge().ok());
    const double whole = smoother.cost();
    const FactorId closure = names.back();
    smoother.set_weight(closure, 0.0);
    REQUIRE(smoother.converge().ok());
    const Values<SE3d> without = smoother.values();
    CHECK(smoother.weight(closure) == 0.0);
    smoother.set_weight(closure, 0.25);
    REQUIRE(smoother.converge().ok());
    const double quarter = smoother.cost();
    CHECK(quarter < whole);
    smoother.undo();
    smoother.set_weight(closure, 1.0);
    REQUIRE(smoother.converge().ok());
    CHECK(smoother.cost() == doctest::Approx(whole).epsilon(1e-7));
    smoother.remove(closure);
    REQUIRE(smoother.converge().ok());
    CHECK(largest_difference(smoother.values(), without) < 1e-5);
    CHECK(smoother.cost() < quarter);
    CHECK_THROWS_AS(smoother.set_weight(closure, 1.0), std::invalid_argument);
    CHECK_THROWS_AS(smoother.set_weight(names.front(), -1.0), std::invalid_argument);
  }

  TEST_CASE("a session that was saved is appended in one call, carried over, and tied") {
    Rng rng(12);
    Twin first, second;
    for (Twin* const twin : {&first, &second}) {
      Walk walk(rng);
      for (int k = 0; k < 25; ++k) walk.step(*twin);
      REQUIRE(twin->smoother.converge().ok());
    }
    second.smoother.marginalize(std::vector<Key>{0, 1});
    REQUIRE(second.smoother.update().ok());
    Smoother& smoother = first.smoother;
    const double cost = smoother.cost();
    const Index factors = smoother.factor_count();
    const Smoother saved = Smoother::load(second.smoother.save());
    CHECK(smoother.append(saved) == 25);
    REQUIRE(smoother.update().ok());
    CHECK(smoother.size() == 50);
    CHECK(smoother.factor_count() == factors + saved.factor_count());
    CHECK(smoother.cost() == doctest::Approx(cost + saved.cost()).epsilon(1e-4));
    for (Key key = 0; key < 25; ++key) CHECK(smoother[25 + key].local(saved[key]).norm() < 1e-4);
    PoseGraph graph = random_graph<SE3d>(rng, 5, 0.01);
    graph.set_fixed(2);
    CHECK(smoother.append(graph) == 50);
    REQUIRE(smoother.update().ok());
    CHECK(smoother.is_fixed(52));
    CHECK(smoother[52] == graph[2]);
  }

  TEST_CASE("of a street walk whose closures lie by the dozen, graduated non-convexity keeps the honest optimum") {
    for (std::uint64_t seed = 1; seed <= (quick() ? 1U : 3U); ++seed) {
      StreetWalk walk({.sessions = 2, .keyframes = 300, .blocks = 2, .outliers = 0.25, .seed = seed});
      Smoother robust, plain, honest;
      IncrementalGnc<Smoother> gnc(robust);
      std::vector<std::pair<Index, bool>> candidates;
      Index steps = 0;
      for (Key key = 0; !walk.done(); ++key) {
        const StreetWalk::Step step = walk.next();
        for (Smoother* const smoother : {&robust, &plain, &honest}) {
          smoother->add_value(step.starts ? step.motion : (*smoother)[key - 1] * step.motion);
          if (step.starts) smoother->add_prior(key, step.motion, StreetWalk::start_noise());
          if (!step.starts) smoother->add_between(key - 1, key, step.motion, StreetWalk::odometry_noise());
          for (const StreetWalk::Closure& closure : step.closures) {
            const BetweenFactor<SE3d> factor{closure.from, key, closure.T_from_to,
                                             StreetWalk::closure_noise().sqrt_information()};
            if (smoother == &robust)
              candidates.emplace_back(gnc.add(factor), closure.lies);
            else if (smoother == &plain || !closure.lies)
              smoother->add(factor);
          }
        }
        const IncrementalGncReport report = gnc.update();
        REQUIRE(report.last.ok());
        CHECK(report.decided);
        steps += report.steps;
      }
      Index lies = 0, believed = 0, doubted = 0;
      for (const auto& [candidate, lie] : candidates) {
        lies += lie ? 1 : 0;
        believed += lie && gnc.is_in(candidate) ? 1 : 0;
        doubted += !lie && !gnc.is_in(candidate) ? 1 : 0;
      }
      REQUIRE(honest.converge().ok());
      REQUIRE(robust.converge().ok());
      REQUIRE(plain.converge().ok());
      const auto worst = [&](const Smoother& smoother) {
        double most = 0.0;
        for (Key key = 0; key < smoother.size(); ++key)
          most = std::max(most, (smoother[key].translation() - honest[key].translation()).norm());
        return most;
      };
      INFO(lies, " lies, ", believed, " believed, ", doubted, " doubted, ", steps, " steps, worst ", worst(robust), " ",
           worst(plain));
      CHECK(lies > 5);
      CHECK(believed == 0);
      CHECK(doubted <= to_index(candidates.size()) / 20);
      CHECK(worst(robust) < 0.05);
      CHECK(worst(plain) > 1.0);
      CHECK(steps < 4 * robust.size());
    }
  }

  TEST_CASE("an update that fails takes its candidates back, and the next decides as if they had never been") {
    const auto step = SE3d(SO3d(), {1, 0, 0});
    const auto noise = Smoother::Noise::from_sigma(0.1).sqrt_information();
    const OutlierTest odometry{.threshold = 40, .outlier_weight = 1e-8, .trusted = true};
    const auto grow = [&](Smoother& smoother, IncrementalGnc<Smoother>& gnc, Index count) {
      for (Index k = 0; k < count; ++k) {
        const Key key = smoother.add_value(SE3d(SO3d(), {1.0 * smoother.size(), 0, 0}));
        OutlierTest next = odometry;
        next.previous = key - 2;  // of step `key - 1`, the one before; -1 of the first
        gnc.add({key - 1, key, step, noise}, next);
      }
    };
    Smoother whole, failed;
    IncrementalGnc<Smoother> of_whole(whole), of_failed(failed);
    for (auto [smoother, gnc] : {std::pair{&whole, &of_whole}, {&failed, &of_failed}}) {
      smoother->add_value(SE3d());
      smoother->add_prior(0, SE3d(), Smoother::Noise::from_sigma(0.01));
      grow(*smoother, *gnc, 4);
      REQUIRE(gnc->update().last.ok());
    }
    grow(failed, of_failed, 1);
    failed.add_value(SE3d());  // which nothing constrains
    REQUIRE_FALSE(of_failed.update().last.ok());
    CHECK(failed.size() == 5);
    for (auto [smoother, gnc] : {std::pair{&whole, &of_whole}, {&failed, &of_failed}}) {
      grow(*smoother, *gnc, 3);
      for (const Key to : {6, 7})
        gnc->add({to - 5, to, SE3d(SO3d(), {9, 0, 0}), noise}, {.threshold = 40, .forecast = true});
      REQUIRE(gnc->update().last.ok());
    }
    CHECK(failed.values() == whole.values());
  }

  TEST_CASE("a candidate that is dropped is neither the next of its sequence nor a member of its group") {
    detail::CandidateList<SE3d> list;
    const auto add = [&](Key from, Index leader, Index previous) {
      detail::CandidateList<SE3d>::Entry entry;
      entry.factor.from = from;
      entry.factor.to = from + 1;
      entry.leader = leader;
      entry.previous = previous;
      return list.add(entry);
    };
    const Index first = add(0, -1, -1), second = add(1, first, first);
    CHECK(list[first].next == second);
    CHECK(list[first].members == 2);
    list.drop_last();
    CHECK(list[first].next == list.none);
    CHECK(list[first].members == 1);
    CHECK(list[first].newest == first);
    list.for_each_at(2, [](Index) { FAIL_CHECK("still at its variable"); });
  }
}
