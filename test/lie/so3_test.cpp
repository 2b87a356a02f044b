#include "chainslam/lie/so3.hpp"

#include <doctest/doctest.h>

#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "lie/dual.hpp"
#include "lie/laws.hpp"

namespace chainslam::test {
namespace {

constexpr long double pi = std::numbers::pi_v<long double>;
using Vector3l = Eigen::Matrix<long double, 3, 1>;

/// Zero, tiny, the library's switches from both sides, and all around pi.
std::vector<long double> angles() {
  std::vector<long double> list{0, 0.3L,       0.0199L,    0.0200L, 0.0201L,   0.9999999L,
                                1, 1.0000001L, 1.9999999L, 2,       2.0000001L};
  list.insert(list.end(), {2 * pi / 3, 2.5L, 3, pi / 2});
  for (int exponent = -20; exponent <= -3; ++exponent) {
    list.push_back(std::pow(10.0L, static_cast<long double>(exponent)));
    list.push_back(pi - std::pow(10.0L, static_cast<long double>(exponent)));
  }
  return list;
}

std::vector<Vector3l> axes() {
  return {Vector3l(1, 0, 0),  Vector3l(0, 1, 0), Vector3l(0, 0, 1),  Vector3l(-1, 0, 0),    Vector3l(0, 0, -1),
          Vector3l(0, -1, 0), Vector3l(1, 1, 0), Vector3l(1, -2, 3), Vector3l(-3, 1e-9L, 2)};
}

/// The rotation about the unit `axis` by `angle` (Rodrigues), in long double.
Eigen::Matrix<long double, 3, 3> reference_matrix(const Vector3l& axis, long double angle) {
  const Eigen::Matrix<long double, 3, 3> K = chainslam::detail::hat3<long double>(axis);
  const long double half = std::sin(angle / 2);
  return Eigen::Matrix<long double, 3, 3>::Identity() + std::sin(angle) * K + 2 * half * half * K * K;
}

template <class Scalar>
constexpr double few_epsilon = 8.0 * static_cast<double>(std::numeric_limits<Scalar>::epsilon());

/// sum_k (-1)^k w_k x^k / (2k + first)! in long double with enough terms for x <= 10 pi.
long double reference_series(int first, bool weighted, long double x) {
  long double sum = 0;
  for (int k = 40; k >= 0; --k) {
    long double term = weighted ? k + 1 : 1;
    for (int i = 1; i <= first; ++i) term /= i;
    for (int i = 0; i < k; ++i) term *= -x / (static_cast<long double>(first + 2 * i + 1) * (first + 2 * i + 2));
    sum += term;
  }
  return sum;
}

}  // namespace

TEST_SUITE("lie/so3") {
  TEST_CASE_TEMPLATE("obeys the laws of a Lie group", G, SO3f, SO3d) {
    check_manifold_laws<G>();
    check_lie_group_laws<G>();
  }

  TEST_CASE("closed-form Jacobians agree with differences") { check_numeric_jacobians<SO3d>(); }

  TEST_CASE_TEMPLATE("exp is exact at every angle, about every axis", Scalar, float, double) {
    for (const Vector3l& direction : axes()) {
      const Vector3l axis = direction / direction.norm();
      for (const long double angle : angles()) {
        CAPTURE(static_cast<double>(angle));
        const Eigen::Matrix<Scalar, 3, 1> w = (axis * angle).cast<Scalar>();
        const Vector3l exact = w.template cast<long double>();  // the reference turns by what w really holds
        const long double exact_angle = exact.norm();
        const Vector3l exact_axis = exact_angle > 0 ? Vector3l(exact / exact_angle) : Vector3l(1, 0, 0);
        const auto R = SO3<Scalar>::exp(w).matrix().template cast<long double>().eval();
        CHECK(static_cast<double>((R - reference_matrix(exact_axis, exact_angle)).norm()) < few_epsilon<Scalar>);
      }
    }
  }

  TEST_CASE_TEMPLATE("turns one direction into another by the least angle", Scalar, float, double) {
    using Vector3 = typename SO3<Scalar>::Vector3;
    const Scalar rounding = 16 * std::numeric_limits<Scalar>::epsilon();
    for (const Vector3l& a : axes())
      for (const Vector3l& b : axes()) {
        const Vector3 from = a.cast<Scalar>(), to = (2 * b).cast<Scalar>();
        const SO3<Scalar> R = SO3<Scalar>::between(from, to);
        CHECK((R * from.normalized() - to.normalized()).norm() < rounding);
        const Scalar angle = std::atan2(from.cross(to).norm(), from.dot(to));
        CHECK(R.log().norm() == doctest::Approx(static_cast<double>(angle)).epsilon(static_cast<double>(rounding)));
      }
  }

  TEST_CASE_TEMPLATE("log gives every angle back with all its digits", Scalar, float, double) {
    for (const Vector3l& direction : axes()) {
      const Vector3l axis = direction / direction.norm();
      for (const long double angle : angles()) {
        CAPTURE(static_cast<double>(angle));
        const Eigen::Matrix<Scalar, 3, 1> w = (axis * angle).cast<Scalar>();
        const Eigen::Matrix<Scalar, 3, 1> back = SO3<Scalar>::exp(w).log();
        // Relative to the angle: tiny rotations keep their digits too. Past pi, by rounding, -w may come back.
        const bool at_pi = static_cast<double>(pi - angle) < few_epsilon<Scalar>;
        const double error =
            static_cast<double>(at_pi ? std::min((back - w).norm(), (back + w).norm()) : (back - w).norm());
        CHECK(error <= few_epsilon<Scalar> * static_cast<double>(angle));
      }
    }
  }

  TEST_CASE_TEMPLATE("a rotation matrix gives its rotation vector at every angle", Scalar, float, double) {
    for (const Vector3l& direction : axes()) {
      const Vector3l axis = direction / direction.norm();
      for (const long double angle : angles()) {
        CAPTURE(static_cast<double>(angle));
        const auto R = reference_matrix(axis, angle).cast<Scalar>().eval();
        const Vector3l back = SO3<Scalar>::from_matrix(R).log().template cast<long double>();
        const bool at_pi = static_cast<double>(pi - angle) < few_epsilon<Scalar>;
        const long double error =
            at_pi ? std::min((back - axis * angle).norm(), (back + axis * angle).norm()) : (back - axis * angle).norm();
        CHECK(static_cast<double>(error) < few_epsilon<Scalar>);  // absolute: entries of R are rounded to epsilon
      }
    }
  }

  TEST_CASE("half turns about each axis, also as the exact matrices diag(1, -1, -1)") {
    for (int i = 0; i < 3; ++i) {
      Eigen::Matrix3d R = -Eigen::Matrix3d::Identity();
      R(i, i) = 1;
      const SO3d half_turn = SO3d::from_matrix(R);
      CHECK(half_turn.log().cwiseAbs() == Eigen::Vector3d::Unit(i) * std::numbers::pi);
      CHECK(near(half_turn.matrix(), R, 1e-16));
      CHECK(near(SO3d::exp(half_turn.log()).matrix(), R, 1e-15));
    }
  }

  TEST_CASE("angles past pi come back by the shorter way, full turns as none") {
    const Eigen::Vector3d axis(2.0 / 3, -1.0 / 3, 2.0 / 3);
    for (const double angle : {3.2, 4.0, 6.0, 6.28}) {
      const Eigen::Vector3d expected = axis * (angle - 2 * std::numbers::pi);
      CHECK(near(SO3d::exp(axis * angle).log(), expected, 2e-15));
      CHECK(near(SO3d::exp(axis * (angle + 20 * std::numbers::pi)).log(), expected, 3e-14));
    }
    CHECK(SO3d::exp(axis * 2 * std::numbers::pi).log().norm() < 4e-15);
  }

  TEST_CASE("q and -q are the same rotation, also to log") {
    for_all(100, [](Rng& rng, int) {
      const SO3d R = random_point<SO3d>(rng);
      const SO3d::Quaternion negative(-R.quaternion().coeffs());
      const SO3d same = SO3d::from_quaternion(negative);
      CHECK(near(same.log(), R.log(), 1e-15));
      CHECK(near(same.matrix(), R.matrix(), 1e-15));
    });
  }

  TEST_CASE("coefficients agree with long-double series from 0 past pi: the switch cannot be seen") {
    std::vector<double> squares{0, 1e-300, 1e-24, 1e-12, 1e-6, 1e-3};
    for (double x = 0.01; x < 10.0; x *= 1.07) squares.push_back(x);
    for (const double x : {1.0, 0.25, 4.0})
      for (const double nudge : {-1e-15, 0.0, 1e-15, 1e-9}) squares.push_back(x * (1 + nudge));
    for (const double x : squares) {
      CAPTURE(x);
      const auto value = chainslam::detail::jacobian_coefficients(x);
      const auto is = [x](double value_at, int first, bool weighted) {
        // Absolute: the coefficients multiply matrices of size theta^0 to theta^2 and are summed with 1.
        return std::abs(static_cast<double>(value_at - reference_series(first, weighted, x))) < 4e-16;
      };
      CHECK(is(chainslam::detail::cosine(x), 0, false));
      CHECK(is(chainslam::detail::sinc(x), 1, false));
      CHECK(is(value.b, 2, false));
      CHECK(is(value.c, 3, false));
      CHECK(is(value.b_slope, 4, true));
      CHECK(is(value.c_slope, 5, true));
      const long double inverse = reference_series(4, true, x) / reference_series(2, false, x);
      CHECK(std::abs(static_cast<double>(chainslam::detail::inverse_jacobian_coefficient(x) - inverse)) < 4e-16);
    }
  }

  TEST_CASE("the inverse Jacobian holds at pi and beyond, up to its pole at 2 pi") {
    const Eigen::Vector3d axis = Eigen::Vector3d(1, -2, 3).normalized();
    for (const double angle : {3.0, std::numbers::pi - 1e-9, std::numbers::pi, std::numbers::pi + 1e-9, 4.0, 6.0}) {
      const Eigen::Vector3d w = axis * angle;
      CHECK(near(SO3d::left_jacobian(w) * SO3d::left_jacobian_inverse(w), Eigen::Matrix3d::Identity(), 2e-14));
    }
  }

  TEST_CASE("a million products leave a rotation orthogonal to rounding") {
    Rng rng(7);
    std::array<SO3d, 16> steps;
    for (SO3d& step : steps) step = random_point<SO3d>(rng);
    SO3d R;
    for (std::size_t i = 0; i < 1'000'000; ++i) R *= steps[i % steps.size()];
    const Eigen::Matrix3d M = R.matrix();
    CHECK((M.transpose() * M - Eigen::Matrix3d::Identity()).norm() < 1e-15 * 10);
    CHECK(std::abs(R.quaternion().norm() - 1) < 1e-15);
  }

  TEST_CASE("a quaternion that is unit up to rounding is kept bit for bit; others are brought to length 1") {
    for_all(200, [](Rng& rng, int) {
      const SO3d R = random_point<SO3d>(rng) * random_point<SO3d>(rng);
      CHECK(SO3d::from_quaternion(R.quaternion()) == R);
      const SO3d::Quaternion longer(R.quaternion().coeffs() * rng.uniform(0.1, 10.0));
      CHECK(near(SO3d::from_quaternion(longer).quaternion().coeffs(), R.quaternion().coeffs(), 1e-15));
    });
  }

  TEST_CASE("a matrix that is a little off gives a rotation as near") {
    for_all(100, [](Rng& rng, int) {
      const SO3d R = random_point<SO3d>(rng);
      Eigen::Matrix3d noise;
      for (Eigen::Index i = 0; i < 9; ++i) noise(i) = rng.uniform(-1e-6, 1e-6);
      CHECK(near(SO3d::from_matrix(R.matrix() + noise).matrix(), R.matrix(), 1e-5));
    });
  }

  TEST_CASE("NaN stays NaN") {
    const Eigen::Vector3d nan = Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
    CHECK(std::isnan(SO3d::exp(nan).log()[0]));
    CHECK(std::isnan(SO3d::left_jacobian(nan)(0, 0)));
  }

  TEST_CASE("dual numbers pass through exp and log, also at zero, where theta itself has no derivative") {
    using Vector3D = Eigen::Matrix<Dual, 3, 1>;
    for (const double scale : {0.0, 1e-9, 0.5, 1.5, 2.9}) {
      const Eigen::Vector3d at = scale * Eigen::Vector3d(2.0 / 3, -2.0 / 3, 1.0 / 3);
      const Eigen::Vector3d along(0.3, 0.1, -0.7);
      Vector3D w;
      for (int i = 0; i < 3; ++i) w[i] = Dual(at[i], along[i]);
      const SO3<Dual> R = SO3<Dual>::exp(w);
      const Vector3D back = R.log();
      const Eigen::Vector3d p(1, 2, 3);
      const Vector3D moved = R * Vector3D(Dual(1), Dual(2), Dual(3));
      const Eigen::Vector3d body_rate = SO3d::right_jacobian(at) * along;
      const Eigen::Vector3d velocity = SO3d::exp(at) * body_rate.cross(p);
      for (int i = 0; i < 3; ++i) {
        CHECK(back[i].value == doctest::Approx(at[i]).epsilon(1e-14));
        CHECK(back[i].derivative == doctest::Approx(along[i]).epsilon(1e-13));
        CHECK(moved[i].derivative == doctest::Approx(velocity[i]).epsilon(1e-13));
      }
    }
  }
}

}  // namespace chainslam::test
