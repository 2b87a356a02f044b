#include <doctest/doctest.h>

#include <numbers>

#include "chainslam/factor_graph/between_factor.hpp"
#include "chainslam/factor_graph/prior_factor.hpp"
#include "chainslam/lie/numeric_jacobian.hpp"
#include "chainslam/lie/se2.hpp"
#include "chainslam/lie/se3.hpp"
#include "factor_graph/pose_graphs.hpp"
#include "support/property.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

struct NoFactor {
  using Value = SE3d;
  static constexpr std::size_t arity = 1;
  std::array<Key, 1> keys() const { return {0}; }
};
static_assert(!Factor<NoFactor>);
static_assert(Factor<BetweenFactor<SE2d, Huber>> && RobustFactor<BetweenFactor<SE2d, Huber>>);

/// All Jacobians against differences of the residual.
template <Factor F>
void check_jacobians(const F& factor, const Values<typename F::Value>& values) {
  using Group = typename F::Value;
  const auto linearized = factor.linearize(values);
  CHECK(linearized.residual.isApprox(factor.residual(values), 1e-12));
  for (std::size_t k = 0; k < F::arity; ++k) {
    const Key key = factor.keys()[k];
    const auto expected = numeric_jacobian(
        [&](const Group& moved) {
          Values<Group> others = values;
          others[key] = moved;
          return Eigen::Matrix<double, F::rows, 1>(factor.residual(others));
        },
        values[key]);
    // numeric_jacobian is good to 1e-12 of the function's scale; residuals here are below 100
    CHECK((linearized.jacobians[k] - expected).norm() < 1e-9 * (1.0 + expected.norm()));
  }
}

}  // namespace

TEST_SUITE("factor_graph/factors") {
  TEST_CASE_TEMPLATE("Jacobians are exact for small and large errors", Group, SE3d, SE2d) {
    for_all(60, [](Rng& rng, int size) {
      Values<Group> values;
      values.add(random_pose<Group>(rng));
      const double error = size % 3 == 0 ? 0.0 : size % 3 == 1 ? 1e-5 : 0.7;
      const Group offset = Group::exp(random_tangent<Group>(rng, 3.0 * error, error));
      const Group T_from_to = random_pose<Group>(rng);
      values.add(values[0] * T_from_to);
      const auto root = random_noise<Group::dof>(rng).sqrt_information();
      check_jacobians(BetweenFactor<Group>{0, 1, T_from_to * offset, root}, values);
      check_jacobians(BetweenFactor<Group>{1, 0, T_from_to.inverse() * offset, root}, values);
      check_jacobians(PriorFactor<Group>{1, values[1] * offset, root}, values);
    });
  }

  TEST_CASE("Jacobians stay right near half a turn") {
    Values<SE3d> values;
    values.add(SE3d());
    Vector6d tangent = Vector6d::Zero();
    tangent << 1.0, -2.0, 0.5, 0.0, 0.0, std::numbers::pi - 1e-2;  // the differences reach 1.5e-3 far
    values.add(SE3d::exp(tangent));
    check_jacobians(BetweenFactor<SE3d>{0, 1, SE3d()}, values);
  }

  TEST_CASE_TEMPLATE("residuals vanish where the measurement says, and are read in the frame of `from`", Group, SE3d,
                     SE2d) {
    Rng rng(7);
    Values<Group> values;
    values.add(random_pose<Group>(rng));
    values.add(random_pose<Group>(rng));
    const Group T_from_to = values[0].inverse() * values[1];
    CHECK(BetweenFactor<Group>{0, 1, T_from_to}.residual(values).norm() < 1e-14);
    CHECK(BetweenFactor<Group>{1, 0, T_from_to.inverse()}.residual(values).norm() < 1e-14);
    CHECK(BetweenFactor<Group>{0, 1, T_from_to.inverse()}.residual(values).norm() > 0.1);
    CHECK(PriorFactor<Group>{1, values[1]}.residual(values).norm() < 1e-14);
    typename Group::Tangent d = random_tangent<Group>(rng, 0.1, 0.1);
    values[1] = values[1].retract(d);
    CHECK(BetweenFactor<Group>{0, 1, T_from_to}.residual(values).isApprox(d, 1e-12));
  }
}
