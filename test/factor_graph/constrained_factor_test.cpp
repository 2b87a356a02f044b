#include "chainslam/factor_graph/constrained_factor.hpp"

#include <doctest/doctest.h>
#include <Eigen/QR>

#include <cstddef>
#include <limits>
#include <span>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

#include "chainslam/factor_graph/batch_optimizer.hpp"
#include "chainslam/factor_graph/factors.hpp"
#include "chainslam/factor_graph/incremental_smoother.hpp"
#include "factor_graph/pose_graphs.hpp"
#include "factor_graph/smoother_twin.hpp"
#include "support/property.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

const double free_row = std::numeric_limits<double>::infinity();
/// On the plane z = 0, upright.
const Vector6d on_plane{free_row, free_row, 0, 0, 0, free_row};

/// A walk on the plane z = 0 whose odometry climbs, and of which two poses are known to be so far apart.
Graph flat_walk(Rng& rng, Index size) {
  Graph graph;
  std::vector<SE3d> truth;
  const auto noise = [&] { return SE3d::exp(random_tangent<SE3d>(rng, 0.05, 0.05)); };
  for (Key key = 0; key < size; ++key) {
    const SE3d step(SO3d::exp({0.0, 0.0, 0.4 * rng.normal()}), Eigen::Vector3d(1.0, 0.1 * rng.normal(), 0.0));
    truth.push_back(key == 0 ? SE3d() : truth.back() * step);
    graph.add_value(key == 0 ? SE3d() : graph[key - 1] * step * noise());
    const SqrtInformation<6> root = NoiseModel<6>::from_sigma(0.05).sqrt_information();
    if (key == 0) graph.add(PriorFactor<SE3d>{0, noise(), root});
    if (key > 0) graph.add(BetweenFactor<SE3d>{key - 1, key, step * noise(), root});
    if (key % 2 == 0) graph.add(constrained(PriorFactor<SE3d>{.key = key, .mean = {}}, on_plane, 1e-3));
  }
  graph.add(constrained(
      BetweenFactor<SE3d>{.from = 1, .to = size - 1, .measurement = truth[1].inverse() * truth.back() * noise()},
      (Vector6d() << 0, 0, free_row, free_row, 0.1, 0).finished(), 1e-3));
  return graph;
}

/// Rows of factors, those that must be zero apart from the others.
class StackedRows {
 public:
  explicit StackedRows(Index variables) : gradient_(Eigen::VectorXd::Zero(6 * variables)), hard_(gradient_.size(), 0) {}

  void add(std::span<const Key> keys, const std::vector<Eigen::MatrixXd>& jacobians, const Eigen::VectorXd& residual,
           const Vector6d& is_hard) {
    for (int row = 0; row < 6; ++row) {
      Eigen::VectorXd way = Eigen::VectorXd::Zero(gradient_.size());
      for (std::size_t k = 0; k < keys.size(); ++k)
        for (int column = 0; column < 6; ++column) way[6 * keys[k] + column] = jacobians[k](row, column);
      if (is_hard[row] == 0.0) {
        way *= residual[row];
        gradient_ += way;
        size_ += way.norm();
      } else {
        hard_.conservativeResize(Eigen::NoChange, hard_.cols() + 1);
        hard_.rightCols<1>() = way / way.norm();
      }
    }
  }

  /// By how much of its length the gradient of all soft rows is not a combination of the hard ones.
  [[nodiscard]] double gradient_beside_hard() const {
    const Eigen::VectorXd combination = hard_ * hard_.householderQr().solve(gradient_);
    return Eigen::VectorXd(gradient_ - combination).norm() / size_;
  }

 private:
  Eigen::VectorXd gradient_;
  Eigen::MatrixXd hard_;
  double size_ = 0.0;
};

/// Karush, Kuhn and Tucker: 0 at a constrained optimum.
template <class Holder>
double gradient_beside_constraints(const Holder& graph, const Values<SE3d>& values) {
  StackedRows rows(values.size());
  const auto add = [&](const auto& factor, const Vector6d& is_hard) {
    const auto linearized = factor.linearize(values);
    rows.add(factor.keys(), {linearized.jacobians.begin(), linearized.jacobians.end()}, linearized.residual, is_hard);
  };
  graph.for_each_factor([&](const auto& factor) {
    if constexpr (requires { factor.hard; })
      add(factor.factor, factor.hard);
    else
      add(factor, Vector6d::Zero());
  });
  return rows.gradient_beside_hard();
}

}  // namespace

TEST_SUITE("factor_graph/constrained_factor") {
  TEST_CASE("rows that must be zero are, and the rest is at its best on them, in batch and incrementally") {
    for_all(12, [](Rng& rng, int size) {
      Graph graph = flat_walk(rng, 4 + size / 2);
      Smoother smoother;
      smoother.append(graph);
      const OptimizeReport batch = optimize(graph);
      REQUIRE(batch.ok());
      CHECK(batch.violation < 1e-9);
      CHECK(gradient_beside_constraints(graph, graph.values()) < 1e-6);
      for (Key key = 0; key < graph.values().size(); key += 2) CHECK(std::abs(graph[key].translation().z()) < 1e-9);
      double soft = 0.0;  // without the springs
      graph.for_each_factor([&](const auto& factor) {
        if constexpr (requires { factor.hard; })
          soft += (Vector6d::Ones() - factor.hard).cwiseProduct(factor.factor.residual(graph.values())).squaredNorm();
        else
          soft += factor.residual(graph.values()).squaredNorm();
      });
      CHECK(batch.final_cost == doctest::Approx(soft).epsilon(1e-8));

      const ConvergeReport converged = smoother.converge();
      REQUIRE(converged.ok());
      CHECK(converged.violation < 1e-9);
      CHECK(converged.final_cost <= batch.final_cost * (1 + 1e-6) + 1e-6);
      CHECK(gradient_beside_constraints(smoother, smoother.values()) < 1e-6);
      const Eigen::Index z = 2;
      CHECK(smoother.covariance(0)(z, z) < 1.1e-6);  // the springs' softness, squared
    });
  }

  TEST_CASE("a variable all of whose rows must be zero is as one that is fixed there") {
    Rng rng(7);
    const PoseGraph walk = random_graph<SE3d>(rng, 12, 0.05);
    Graph pinned, held;
    for (const SE3d& pose : walk.values()) {
      pinned.add_value(pose);
      held.add_value(pose);
    }
    for (const auto& between : walk.betweens()) {
      pinned.add(between);
      held.add(between);
    }
    for (const Key key : {0, 7}) {
      const SE3d place = walk[key] * SE3d::exp(random_tangent<SE3d>(rng, 0.5, 0.1));
      pinned.add(constrained(PriorFactor<SE3d>{.key = key, .mean = place}, Vector6d::Zero()));
      held.set_value(key, place);
      held.set_fixed(key);
    }
    const OptimizeReport report = optimize(pinned);
    REQUIRE(report.ok());
    REQUIRE(optimize(held).ok());
    CHECK(report.violation < 1e-10);
    for (Key key = 0; key < walk.values().size(); ++key) CHECK(pinned[key].local(held[key]).norm() < 1e-5);
    CHECK(pinned.cost() == doctest::Approx(held.cost()).epsilon(1e-8));
  }

  TEST_CASE("an update leaves springs off by little; what converged is undone, saved and goes on to the same bits") {
    Rng rng(3);
    Smoother smoother;
    smoother.append(flat_walk(rng, 12));
    REQUIRE(smoother.update().ok());
    const double before = smoother.cost();
    REQUIRE(smoother.converge().ok());
    smoother.undo();  // the last round
    smoother.undo();  // nothing more
    REQUIRE(smoother.converge().violation < 1e-9);
    CHECK(smoother.cost() < before);
    Smoother loaded = Smoother::load(smoother.save());
    CHECK(loaded.cost() == smoother.cost());
    for (Smoother* const each : {&smoother, &loaded}) {
      each->add_value((*each)[3]);
      each->add(constrained(BetweenFactor<SE3d>{.from = 3, .to = 12, .measurement = {}}, Vector6d::Zero()));
      each->add_prior(12, SE3d(), NoiseModel<6>::from_sigma(0.3));
      REQUIRE(each->update().ok());
      CHECK((*each)[3].local((*each)[12]).norm() < 1e-4);
      CHECK(each->converge().violation < 1e-9);
    }
    CHECK(loaded.values() == smoother.values());
    CHECK(smoother[3].local(smoother[12]).norm() < 1e-9);
  }

  TEST_CASE("what contradicts itself ends between, and says how far off it is") {
    Graph graph;
    graph.add_value(SE3d());
    const SE3d aside(SO3d(), Eigen::Vector3d(1.0, 0.0, 0.0));
    graph.add(constrained(PriorFactor<SE3d>{.key = 0, .mean = {}}, Vector6d::Zero()));
    graph.add(constrained(PriorFactor<SE3d>{.key = 0, .mean = aside}, Vector6d::Zero()));
    const OptimizeReport report = optimize(graph);
    REQUIRE(report.ok());
    CHECK(report.violation == doctest::Approx(0.5));
    CHECK(graph[0].translation().x() == doctest::Approx(0.5));
  }

  TEST_CASE("its Jacobians are the factor's, and what makes no sense is refused") {
    Rng rng(5);
    Values<SE3d> values;
    values.add(random_pose<SE3d>(rng));
    Pin pin = constrained(PriorFactor<SE3d>{.key = 0, .mean = {}}, on_plane);
    CHECK(jacobian_error(pin, values) < 1e-9);
    const double rest = pin.kernel.cost(pin.residual(values).squaredNorm());
    pin.tighten(values);
    CHECK(pin.kernel.cost(pin.residual(values).squaredNorm()) == doctest::Approx(3.0 * rest));
    CHECK(pin.factor.sqrt_information(0, 0) == 0.0);
    for (const double bad : {-1.0, std::numeric_limits<double>::quiet_NaN()}) {
      CHECK_THROWS_AS(static_cast<void>(constrained(PriorFactor<SE3d>{}, Vector6d::Constant(bad))),
                      std::invalid_argument);
      CHECK_THROWS_AS(static_cast<void>(constrained(PriorFactor<SE3d>{}, on_plane, bad)), std::invalid_argument);
    }
    std::string message;
    try {
      static_cast<void>(NoiseModel<6>::from_sigma(0.0));
    } catch (const std::invalid_argument& error) {
      message = error.what();
    }
    CHECK(message.find("Constrained") != std::string::npos);
  }
}
