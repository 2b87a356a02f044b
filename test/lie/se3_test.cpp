#include "chainslam/lie/se3.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <numbers>
#include <type_traits>

#include "chainslam/lie/concepts.hpp"
#include "lie/dual.hpp"
#include "lie/laws.hpp"

namespace chainslam::test {
namespace {

using Vector6l = Eigen::Matrix<long double, 6, 1>;
using Matrix6l = Eigen::Matrix<long double, 6, 6>;

/// sum ad(xi)^n / (n + 1)! in long double: the definition of the left Jacobian.
Matrix6l reference_left_jacobian(const Vector6l& xi) {
  Matrix6l ad = Matrix6l::Zero();
  ad.topLeftCorner<3, 3>() = chainslam::detail::hat3<long double>(xi.tail<3>());
  ad.topRightCorner<3, 3>() = chainslam::detail::hat3<long double>(xi.head<3>());
  ad.bottomRightCorner<3, 3>() = ad.topLeftCorner<3, 3>();
  Matrix6l sum = Matrix6l::Identity();
  for (int n = 60; n > 0; --n) sum = (Matrix6l::Identity() + ad * sum / (n + 1)).eval();
  return sum;
}

}  // namespace

TEST_SUITE("lie/se3") {
  TEST_CASE("obeys the laws of a Lie group, with the Jacobians that differences give") {
    check_manifold_laws<SE3d>();
    check_lie_group_laws<SE3d>();
    check_numeric_jacobians<SE3d>();
  }

  TEST_CASE("maps points of the source into the target, and chains right to left") {
    const SE3d T_map_body(SO3d::exp(Eigen::Vector3d(0, 0, std::numbers::pi / 2)), Eigen::Vector3d(10, 0, 0));
    const SE3d T_body_lidar(SO3d(), Eigen::Vector3d(1, 0, 2));
    const Eigen::Vector3d p_lidar(3, 0, 0);
    CHECK(near(T_map_body * T_body_lidar * p_lidar, Eigen::Vector3d(10, 4, 2), 1e-14));
    CHECK(near(T_map_body * (T_body_lidar * p_lidar), Eigen::Vector3d(10, 4, 2), 1e-14));
    CHECK(near((T_map_body * T_body_lidar).inverse() * Eigen::Vector3d(10, 4, 2), p_lidar, 1e-14));
  }

  TEST_CASE("perturbs from the right, translation first") {
    const SE3d T(SO3d::exp(Eigen::Vector3d(0, 0, std::numbers::pi / 2)), Eigen::Vector3d(10, 0, 0));
    SE3d::Tangent forward = SE3d::Tangent::Zero();
    forward[0] = 2;
    CHECK(near(T.retract(forward).translation(), Eigen::Vector3d(10, 2, 0), 1e-14));
    CHECK(near(T.local(T.retract(forward)), forward, 1e-14));
  }

  TEST_CASE("a quarter turn while driving one unit of arc ends on the circle") {
    SE3d::Tangent xi;
    xi << 1, 0, 0, 0, 0, std::numbers::pi / 2;
    const double radius = 2 / std::numbers::pi;
    CHECK(near(SE3d::exp(xi).translation(), Eigen::Vector3d(radius, radius, 0), 1e-15));
  }

  TEST_CASE("Jacobians are exact at every angle") {
    const Eigen::Vector3d axis = Eigen::Vector3d(1, -2, 3).normalized();
    std::vector<double> angles{0, 0.5, 0.999999999, 1, 1.000000001, 2, 3, std::numbers::pi, 3.5, 6};
    for (int exponent = -12; exponent <= -3; ++exponent) {
      angles.push_back(std::pow(10.0, exponent));
      angles.push_back(std::numbers::pi - std::pow(10.0, exponent));
    }
    for (const double angle : angles) {
      CAPTURE(angle);
      SE3d::Tangent xi;
      xi << 0.7, 1.5, -2.0, angle * axis;
      const SE3d::Jacobian exact = reference_left_jacobian(xi.cast<long double>()).cast<double>();
      CHECK(near(SE3d::left_jacobian(xi), exact, 5e-15));
      CHECK(near(SE3d::left_jacobian_inverse(xi) * exact, SE3d::Jacobian::Identity(), angle < 4 ? 2e-14 : 1e-12));
      const Eigen::Matrix3f Q = SE3f::left_jacobian(xi.cast<float>()).topRightCorner<3, 3>();
      CHECK(near(Q.cast<double>(), exact.topRightCorner<3, 3>(), 3e-6));
    }
  }

  TEST_CASE("log of a half turn with translation comes back") {
    for (int i = 0; i < 3; ++i) {
      for (const double short_of_pi : {0.0, 1e-12, 1e-9, 1e-6, 1e-3}) {
        SE3d::Tangent xi;
        xi << 3, -4, 5, Eigen::Vector3d::Unit(i) * (std::numbers::pi - short_of_pi);
        const SE3d T = SE3d::exp(xi);
        CHECK(near(SE3d::exp(T.log()).matrix(), T.matrix(), 1e-14));
        if (short_of_pi > 0) CHECK(near(T.log(), xi, 1e-14));
      }
    }
  }

  TEST_CASE("matrices go in and come out") {
    for_all(100, [](Rng& rng, int) {
      const SE3d T = random_point<SE3d>(rng);
      CHECK(near(SE3d::from_matrix(T.matrix()).matrix(), T.matrix(), 1e-14));
      CHECK(near((T * T).matrix(), T.matrix() * T.matrix(), 1e-13));
    });
  }

  TEST_CASE("float agrees with double to float's rounding") {
    for_all(100, [](Rng& rng, int) {
      const SE3f::Tangent xi = random_tangent<SE3f::Tangent>(rng);
      const SE3d::Tangent wide = xi.cast<double>();
      CHECK(near(SE3f::exp(xi).cast<double>().matrix(), SE3d::exp(wide).matrix(), 2e-6));
      CHECK(near(SE3f::left_jacobian(xi).cast<double>(), SE3d::left_jacobian(wide), 2e-6));
      CHECK(near(SE3f::right_jacobian_inverse(xi).cast<double>(), SE3d::right_jacobian_inverse(wide), 2e-5));
    });
  }

  TEST_CASE("is seven doubles that can be copied as bytes") {
    static_assert(sizeof(SE3d) == 56 && alignof(SE3d) == 8);
    static_assert(std::is_trivially_destructible_v<SE3d>);
    static_assert(std::is_nothrow_move_constructible_v<SE3d>);
  }

  TEST_CASE("a pose far from its origin keeps the millimetre: 500 km from it, the return trip is within 1e-9 m") {
    const SE3d T(SO3d::exp(Eigen::Vector3d(0.3, -0.2, 2)), Eigen::Vector3d(4e5, -3e5, 100));
    const Eigen::Vector3d p(12.3, -4.5, 6.7);
    CHECK(near(T.inverse() * (T * p), p, 1e-9));
    CHECK((T * T.inverse()).translation().norm() < 1e-9);
  }

  TEST_CASE("dual numbers differentiate log of a relative pose") {
    using TangentD = SE3<Dual>::Tangent;
    for_all(50, [](Rng& rng, int) {
      const SE3d::Tangent at = random_tangent<SE3d::Tangent>(rng);
      const SE3d::Tangent along = random_tangent<SE3d::Tangent>(rng, 1.0);
      TangentD step;
      TangentD start;
      for (int i = 0; i < 6; ++i) {
        start[i] = Dual(at[i]);
        step[i] = Dual(0, along[i]);
      }
      const TangentD result = (SE3<Dual>::exp(start) * SE3<Dual>::exp(step)).log();
      const SE3d::Tangent expected = SE3d::right_jacobian_inverse(at) * along;
      for (int i = 0; i < 6; ++i) CHECK(result[i].derivative == doctest::Approx(expected[i]).epsilon(1e-11));
    });
  }
}

TEST_SUITE("lie/interpolate") {
  TEST_CASE("keeps the ends bit for bit and moves at constant speed between") {
    for_all(100, [](Rng& rng, int) {
      const SE3d a = random_point<SE3d>(rng);
      const SE3d b = a.retract(random_tangent<SE3d::Tangent>(rng));
      CHECK(interpolate(a, b, 0.0) == a);
      CHECK(interpolate(a, b, 1.0) == b);
      const double t = rng.uniform();
      CHECK(near(a.local(interpolate(a, b, t)), t * a.local(b), 1e-13));
      CHECK(near(b.local(interpolate(a, b, 1 - t)), t * b.local(a), 1e-13));
      CHECK(near(interpolate(a, interpolate(a, b, 0.5), 2.0).local(b), SE3d::Tangent::Zero(), 1e-13));
    });
  }

  TEST_CASE("turns by the shorter way") {
    const SO3d a = SO3d::exp(Eigen::Vector3d(0, 0, 3));
    const SO3d b = SO3d::exp(Eigen::Vector3d(0, 0, -3));
    CHECK(near(interpolate(a, b, 0.5).log().cwiseAbs(), Eigen::Vector3d(0, 0, std::numbers::pi), 1e-14));
  }
}

}  // namespace chainslam::test
