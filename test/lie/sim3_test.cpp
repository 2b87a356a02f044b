#include "chainslam/lie/sim3.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <numbers>

#include "lie/laws.hpp"

namespace chainslam::test {
namespace {

using Vector7l = Eigen::Matrix<long double, 7, 1>;
using Matrix7l = Eigen::Matrix<long double, 7, 7>;

/// sum ad(xi)^n / (n + 1)! in long double, with more terms than |xi| <= 8 needs.
Matrix7l reference_left_jacobian_7(const Vector7l& xi) {
  Matrix7l ad = Matrix7l::Zero();
  ad.topLeftCorner<3, 3>() = chainslam::detail::hat3<long double>(xi.segment<3>(3));
  ad.topLeftCorner<3, 3>().diagonal().array() += xi[6];
  ad.block<3, 3>(0, 3) = chainslam::detail::hat3<long double>(xi.head<3>());
  ad.block<3, 1>(0, 6) = -xi.head<3>();
  ad.block<3, 3>(3, 3) = chainslam::detail::hat3<long double>(xi.segment<3>(3));
  Matrix7l sum = Matrix7l::Identity();
  for (int n = 90; n > 0; --n) sum = (Matrix7l::Identity() + ad * sum / (n + 1)).eval();
  return sum;
}

}  // namespace

TEST_SUITE("lie/sim3") {
  TEST_CASE("obeys the laws of a Lie group") {
    check_manifold_laws<Sim3d>();
    check_lie_group_laws<Sim3d>();
    check_numeric_jacobians<Sim3d>();
  }

  TEST_CASE("is exact for every mix of small and large rotation and scale") {
    const Eigen::Vector3d axis = Eigen::Vector3d(1, -2, 3).normalized();
    for (const double angle : {0.0, 1e-12, 1e-6, 1e-3, 0.6, 0.99, 1.0, 1.01, 2.0, std::numbers::pi - 1e-9, 4.0}) {
      for (const double sigma : {0.0, 1e-12, -1e-9, 1e-6, -1e-3, 0.6, -0.8, 0.9999, 1.0, -1.0001, 2.0, -2.0}) {
        CAPTURE(angle);
        CAPTURE(sigma);
        Sim3d::Tangent xi;
        xi << 0.7, 1.5, -2.0, angle * axis, sigma;
        const Sim3d::Jacobian exact = reference_left_jacobian_7(xi.cast<long double>()).cast<double>();
        const double size = exact.norm();
        // exp's translation is the Jacobian's first block times the tangent's.
        const Eigen::Vector3d translation = exact.topLeftCorner<3, 3>() * xi.head<3>();
        CHECK(near(Sim3d::exp(xi).translation(), translation, 4e-15 * size));
        CHECK(near(Sim3d::left_jacobian(xi), exact, 4e-15 * size));
        CHECK(near(Sim3d::left_jacobian_inverse(xi) * exact, Sim3d::Jacobian::Identity(), 1e-13 * size));
        if (angle < 3.2) CHECK(near(Sim3d::exp(xi).log(), xi, 2e-14));
      }
    }
  }

  TEST_CASE("with scale 1 it is SE(3)") {
    for_all(50, [](Rng& rng, int) {
      const SE3d::Tangent xi = random_tangent<SE3d::Tangent>(rng);
      Sim3d::Tangent wide;
      wide << xi, 0;
      CHECK(near(Sim3d::exp(wide).matrix(), SE3d::exp(xi).matrix(), 1e-14));
      CHECK(near(Sim3d(SE3d::exp(xi)).log(), wide, 1e-14));
      CHECK(Sim3d(SE3d::exp(xi)).rigid() == SE3d::exp(xi));
    });
  }

  TEST_CASE("scales, turns, then shifts") {
    const Sim3d T(SO3d::exp(Eigen::Vector3d(0, 0, std::numbers::pi / 2)), Eigen::Vector3d(10, 0, 0), 3.0);
    CHECK(near(T * Eigen::Vector3d(1, 0, 0), Eigen::Vector3d(10, 3, 0), 1e-14));
    const Eigen::Vector4d homogeneous = T.matrix() * Eigen::Vector4d(1, 0, 0, 1);
    CHECK(near(homogeneous, Eigen::Vector4d(10, 3, 0, 1), 1e-14));
  }
}

}  // namespace chainslam::test
