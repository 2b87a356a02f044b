#include "chainslam/lie/se2.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <numbers>

#include "chainslam/lie/se3.hpp"
#include "lie/laws.hpp"

namespace chainslam::test {
namespace {

/// The same motion in space, about z.
SE3d::Tangent in_space(const SE2d::Tangent& xi) {
  SE3d::Tangent spatial;
  spatial << xi[0], xi[1], 0, 0, 0, xi[2];
  return spatial;
}

/// Rows and columns x, y and yaw of a matrix over se(3).
Eigen::Matrix3d in_plane(const SE3d::Jacobian& J) {
  constexpr int kept[] = {0, 1, 5};
  Eigen::Matrix3d reduced;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) reduced(i, j) = J(kept[i], kept[j]);
  return reduced;
}

}  // namespace

TEST_SUITE("lie/se2") {
  TEST_CASE_TEMPLATE("obeys the laws of a Lie group, with the Jacobians that differences give", G, SO2d, SE2d) {
    check_manifold_laws<G>();
    check_lie_group_laws<G>();
    check_numeric_jacobians<G>();
  }

  TEST_CASE("is SE(3) restricted to the plane: exp, log, adjoint and all Jacobians") {
    for_all(200, [](Rng& rng, int) {
      const SE2d::Tangent xi = random_tangent<SE2d::Tangent>(rng);
      const SE2d T = SE2d::exp(xi);
      const SE3d spatial = SE3d::exp(in_space(xi));
      CHECK(near(T.translation(), spatial.translation().head<2>(), 1e-15));
      CHECK(near(T.rotation().matrix(), spatial.rotation().matrix().topLeftCorner(2, 2), 1e-15));
      CHECK(near(in_space(T.log()), spatial.log(), 4e-15));
      CHECK(near(T.adjoint(), in_plane(spatial.adjoint()), 1e-15));
      CHECK(near(SE2d::left_jacobian(xi), in_plane(SE3d::left_jacobian(in_space(xi))), 2e-15));
      CHECK(near(SE2d::right_jacobian_inverse(xi), in_plane(SE3d::right_jacobian_inverse(in_space(xi))), 4e-15));
    });
  }

  TEST_CASE("half turns keep their digits, angles wrap to (-pi, pi]") {
    for (const double angle : {std::numbers::pi, -std::numbers::pi + 1e-12, 3.0, 1e-12, 0.0}) {
      const SE2d::Tangent xi(3, -4, angle);
      CHECK(near(SE2d::exp(xi).log(), xi, 1e-14));
    }
    CHECK(SO2d::from_angle(4.0).angle() == doctest::Approx(4.0 - 2 * std::numbers::pi).epsilon(1e-15));
    CHECK(std::abs(SO2d::from_angle(2 * std::numbers::pi).angle()) < 1e-15);
  }

  TEST_CASE("a million products leave a rotation orthogonal to rounding") {
    SO2d R;
    const SO2d step = SO2d::from_angle(0.12345);
    for (int i = 0; i < 1'000'000; ++i) R *= step;
    CHECK(std::abs(R.complex().norm() - 1) < 1e-15);
    CHECK(near((R * Eigen::Vector2d(1, 0)), SO2d::from_angle(123450.0).complex(), 1e-9));
  }

  TEST_CASE("matrices go in and come out, a little noise is taken off") {
    const SE2d T = SE2d::exp(SE2d::Tangent(1, 2, 2.5));
    CHECK(near(SE2d::from_matrix(T.matrix()).matrix(), T.matrix(), 1e-15));
    const Eigen::Matrix3d noisy = T.matrix() * 1.001;
    CHECK(near(SE2d::from_matrix(noisy).rotation().matrix(), T.rotation().matrix(), 1e-15));
    CHECK(near(T.cast<float>().matrix().cast<double>(), T.matrix(), 1e-6));
  }
}

}  // namespace chainslam::test
