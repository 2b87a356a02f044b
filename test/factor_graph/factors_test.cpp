#include <doctest/doctest.h>

#include <cmath>
#include <numbers>

#include "chainslam/factor_graph/factors.hpp"
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

/// A between factor that forgets that the logarithm turns.
struct Careless : BetweenFactor<SE3d> {
  [[nodiscard]] Linearized linearize(const Values<SE3d>& values) const {
    Linearized result = BetweenFactor<SE3d>::linearize(values);
    result.jacobians[1] = sqrt_information;
    return result;
  }
};

// numeric_jacobian is good to 1e-12 of the function's scale; residuals here are below 100
template <Factor F>
void check_jacobians(const F& factor, const Values<typename F::Value>& values) {
  CHECK(jacobian_error(factor, values) < 1e-9);
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

  TEST_CASE("positions of an antenna and directions of gravity, too") {
    for_all(30, [](Rng& rng, int size) {
      Values<SE3d> values;
      values.add(SE3d());
      values.add(random_pose<SE3d>(rng));
      const Eigen::Vector3d lever = size % 3 == 0 ? Eigen::Vector3d::Zero() : Eigen::Vector3d(0.3, -1.2, 2.0);
      const GnssFactor<> gnss{.key = 1,
                              .position = values[1] * lever,
                              .lever_arm = lever,
                              .sqrt_information = random_noise<3>(rng).sqrt_information()};
      CHECK(gnss.residual(values).norm() < 1e-12);
      check_jacobians(gnss, values);
      const auto up_map = S2<double>::from_vector({0.1, 0.2, 5});
      const Eigen::Vector3d up_body = values[1].rotation().inverse() * up_map.direction();
      GravityFactor<> gravity{.key = 1, .up_body = S2<double>::from_vector(up_body), .sigma = 0.1, .up_map = up_map};
      CHECK(gravity.residual(values).norm() < 1e-12);
      check_jacobians(gravity, values);
      gravity.up_body = gravity.up_body.retract({0.02, -0.01});
      CHECK(gravity.residual(values).norm() == doctest::Approx(std::sqrt(5e-4) / 0.1).epsilon(1e-3));
      check_jacobians(gravity, values);
      gravity.up_body = S2<double>::from_vector(-up_body);
      CHECK(gravity.residual(values).norm() == doctest::Approx(20));
    });
  }

  TEST_CASE("a term that is missing shows") {
    Rng rng(3);
    Values<SE3d> values;
    values.add(random_pose<SE3d>(rng));
    values.add(random_pose<SE3d>(rng));
    CHECK(jacobian_error(Careless{{0, 1, SE3d()}}, values) > 0.01);
    CHECK(jacobian_error(BetweenFactor<SE3d>{0, 1, SE3d()}, values) < 1e-9);
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
