#include "chainslam/lie/jacobians.hpp"

#include <doctest/doctest.h>

#include <cmath>

#include "chainslam/lie/se3.hpp"
#include "lie/laws.hpp"

namespace chainslam::test {

TEST_SUITE("lie/numeric_jacobian") {
  TEST_CASE("differentiates a function of vectors to twelve digits") {
    const Eigen::Vector2d x(0.3, -0.8);
    const auto J = numeric_jacobian(
        [](const Eigen::Vector2d& v) { return Eigen::Vector3d(std::sin(v[0]), v[0] * v[1], std::exp(v[1])); }, x);
    Eigen::Matrix<double, 3, 2> exact;
    exact << std::cos(x[0]), 0, x[1], x[0], 0, std::exp(x[1]);
    CHECK(near(J, exact, 2e-12));
  }

  TEST_CASE("takes tangents as the manifold's own retract does: a moved point under a right perturbation") {
    Rng rng(1);
    const SE3d T = random_point<SE3d>(rng);
    const Eigen::Vector3d p(1, -2, 3);
    const auto J = numeric_jacobian([&](const SE3d& x) { return Eigen::Vector3d(x * p); }, T);
    Eigen::Matrix<double, 3, 6> exact;
    exact << T.rotation().matrix(), -T.rotation().matrix() * SO3d::hat(p);
    CHECK(near(J, exact, 1e-11));
  }

  TEST_CASE("from manifold to manifold: the inverse of a motion turns by minus its adjoint") {
    Rng rng(2);
    const SE3d T = random_point<SE3d>(rng);
    const auto J = numeric_jacobian([](const SE3d& x) { return x.inverse(); }, T);
    CHECK(near(J, -T.adjoint(), 1e-11));
  }
}

}  // namespace chainslam::test
