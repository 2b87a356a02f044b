#include "chainslam/cloud/plane_fit.hpp"

#include <doctest/doctest.h>

#include <Eigen/Eigenvalues>
#include <limits>
#include <vector>

#include "support/property.hpp"

namespace chainslam {
namespace {

using test::for_all;

Eigen::Vector3d random_unit(Rng& rng) { return Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal()).normalized(); }

void check_eigen(const Eigen::Matrix3d& m) {
  const SymmetricEigen3 ours = symmetric_eigen(m);
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> theirs(m);  // iterative: the reference
  const double scale = std::max(m.cwiseAbs().maxCoeff(), std::numeric_limits<double>::min());
  CHECK((ours.values - theirs.eigenvalues()).norm() / scale < 1e-13);
  CHECK((ours.vectors.transpose() * ours.vectors - Eigen::Matrix3d::Identity()).norm() < 1e-13);
  CHECK(ours.vectors.determinant() == doctest::Approx(1.0));
  CHECK((m * ours.vectors - ours.vectors * ours.values.asDiagonal()).norm() / scale < 1e-13);
}

TEST_SUITE("cloud/symmetric_eigen") {
  TEST_CASE("agrees with the iterative solver for any spread of eigenvalues") {
    for_all(300, [](Rng& rng, int) {
      Eigen::Matrix3d q;
      q.col(0) = random_unit(rng);
      q.col(1) = q.col(0).unitOrthogonal();
      q.col(2) = q.col(0).cross(q.col(1));
      const Eigen::Vector3d values = Eigen::Vector3d::NullaryExpr(
          [&](Eigen::Index) { return (rng.uniform() < 0.3 ? -1 : 1) * std::pow(10.0, rng.uniform(-12, 3)); });
      const Eigen::Matrix3d m = q * values.asDiagonal() * q.transpose();
      check_eigen(0.5 * (m + m.transpose()));
    });
  }

  TEST_CASE("double, triple and zero eigenvalues") {
    check_eigen(Eigen::Matrix3d::Zero());
    check_eigen(Eigen::Matrix3d::Identity());
    check_eigen(1e300 * Eigen::Matrix3d::Identity());
    check_eigen(Eigen::Vector3d(1, 1, 2).asDiagonal());
    check_eigen(Eigen::Vector3d(1, 2, 2).asDiagonal());
    check_eigen(Eigen::Vector3d(0, 0, 1e-200).asDiagonal());
    check_eigen(Eigen::Vector3d(-1, 0, 1).asDiagonal());
    check_eigen(Eigen::Vector3d(1, 1 + 1e-15, 1 - 1e-15).asDiagonal());
    check_eigen(Eigen::Matrix3d::Ones());
    Eigen::Matrix3d m;
    m << 1, 1e-9, 0, 1e-9, 1, 0, 0, 0, 1 + 1e-9;
    check_eigen(m);
  }
}

TEST_SUITE("cloud/plane_fit") {
  TEST_CASE("finds a plane wherever it lies, also through the origin and 500 km away") {
    for (const double away : {0.0, 1.0, 20'000.0, 500'000.0}) {
      for_all(50, [&](Rng& rng, int size) {
        const Eigen::Vector3d normal = random_unit(rng), u = normal.unitOrthogonal(), w = normal.cross(u);
        const Eigen::Vector3d origin = away * random_unit(rng);
        std::vector<Eigen::Vector3d> points;
        for (int i = 0; i < 4 + size; ++i)
          points.emplace_back(origin + rng.uniform(-1, 1) * u + rng.uniform(-1, 1) * w);
        const PlaneFit fit = fit_plane(points);
        REQUIRE(fit.good());
        CHECK(std::abs(fit.normal.dot(normal)) == doctest::Approx(1.0).epsilon(1e-9));
        CHECK(fit.eigenvalues[0] < 1e-12);
        for (const Eigen::Vector3d& p : points) {
          CHECK(std::abs(fit.distance(p)) < 1e-9);
          CHECK(std::abs(fit.normal.dot(p) + fit.offset) < 1e-9);
        }
      });
    }
  }

  TEST_CASE("eigenvalues are variances along the axes") {
    Rng rng(1);
    std::vector<Eigen::Vector3d> points;
    for (int i = 0; i < 20'000; ++i) points.emplace_back(3 * rng.normal(), 0.01 * rng.normal(), rng.normal());
    const PlaneFit fit = fit_plane(points);
    CHECK(fit.eigenvalues[0] == doctest::Approx(1e-4).epsilon(0.05));  // 5 sigma of a variance of 20 000 samples
    CHECK(fit.eigenvalues[1] == doctest::Approx(1.0).epsilon(0.05));
    CHECK(fit.eigenvalues[2] == doctest::Approx(9.0).epsilon(0.05));
    CHECK(fit.planarity() == doctest::Approx(1.0 / 9.0).epsilon(0.1));
    CHECK(fit.curvature() == doctest::Approx(1e-5).epsilon(0.1));
    CHECK(std::abs(fit.tangent[0]) > 0.99);
  }

  TEST_CASE("five float columns, as a matrix, are a cloud") {
    Eigen::Matrix<float, 3, 5> points;
    points << 0, 1, 0, 1, 2, 0, 0, 1, 1, 3, 2, 2, 2, 2, 2;
    const PlaneFit fit = fit_plane(points);
    REQUIRE(fit.good());
    CHECK(std::abs(fit.normal[2]) == doctest::Approx(1.0));
    CHECK(std::abs(fit.offset) == doctest::Approx(2.0));
  }

  TEST_CASE("what is no plane is said, not guessed") {
    using Points = std::vector<Eigen::Vector3f>;
    CHECK(fit_plane(Points{}).status == PlaneStatus::too_few_points);
    CHECK(fit_plane(Points{{0, 0, 0}, {1, 0, 0}}).status == PlaneStatus::too_few_points);
    CHECK(fit_plane(Points{{1, 2, 3}, {1, 2, 3}, {1, 2, 3}}).status == PlaneStatus::degenerate);
    CHECK(fit_plane(Points(9, {0.1f, -70.3f, 1e4f})).status == PlaneStatus::degenerate);
    CHECK(fit_plane(Points{{0, 0, 0}, {1, 2, 3}, {2, 4, 6}, {-3, -6, -9}}).status == PlaneStatus::degenerate);
    const float nan = std::numeric_limits<float>::quiet_NaN();
    CHECK(fit_plane(Points{{0, 0, 0}, {1, 0, 0}, {0, nan, 0}}).status == PlaneStatus::not_finite);
    const float inf = std::numeric_limits<float>::infinity();
    CHECK(fit_plane(Points{{0, 0, 0}, {1, 0, 0}, {0, inf, 0}}).status == PlaneStatus::not_finite);
  }
}

}  // namespace
}  // namespace chainslam
