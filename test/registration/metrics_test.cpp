#include <doctest/doctest.h>

#include <Eigen/LU>

#include "chainslam/lie/jacobians.hpp"
#include "chainslam/registration/detail/pair_sums.hpp"
#include "chainslam/registration/metrics.hpp"
#include "registration/scenes.hpp"
#include "support/property.hpp"

namespace chainslam::test {
namespace {

Eigen::Vector3d random_unit(Rng& rng) { return Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal()).normalized(); }

std::array<double, 3> numbers(const Eigen::Vector3d& v) { return {v[0], v[1], v[2]}; }

Eigen::Matrix3d matrix(const std::array<double, 6>& m) {
  Eigen::Matrix3d result;
  result << m[0], m[1], m[2], m[1], m[3], m[4], m[2], m[4], m[5];
  return result;
}
std::array<double, 6> triangle(const Eigen::Matrix3d& m) {
  return {m(0, 0), m(0, 1), m(0, 2), m(1, 1), m(1, 2), m(2, 2)};
}

Eigen::Matrix3d disc_of(const Eigen::Vector3d& n, double thickness) {
  return Eigen::Matrix3d::Identity() - (1 - thickness) * n * n.transpose();
}

Eigen::Matrix3d random_covariance(Rng& rng) {
  Eigen::Matrix3d A;
  for (int i = 0; i < 9; ++i) A(i / 3, i % 3) = rng.normal();
  return A * A.transpose() + 0.1 * Eigen::Matrix3d::Identity();
}

/// One pair that stays matched, with all that any metric may ask for.
struct TestPair {
  Eigen::Vector3d x, q;  ///< source point in the source's frame, its match in the target's
  Eigen::Vector3d source_normal, target_normal;
  Eigen::Matrix3d source_covariance, target_covariance;

  explicit TestPair(Rng& rng)
      : x(4 * rng.normal(), 4 * rng.normal(), rng.normal()),
        q(3 * rng.normal(), 3 * rng.normal(), rng.normal()),
        source_normal(random_unit(rng)),
        target_normal(random_unit(rng)),
        source_covariance(random_covariance(rng)),
        target_covariance(random_covariance(rng)) {}

  [[nodiscard]] SurfacePair<double> at(const SE3d& T, const SO3d& turned_by) const {
    const Eigen::Matrix3d R = turned_by.matrix();
    const Eigen::Vector3d turned = R * source_normal;
    return {.offset = numbers(T * x - q),
            .source_normal = numbers(turned),
            .target_normal = numbers(target_normal),
            .source_covariance = triangle(R * source_covariance * R.transpose()),
            .target_covariance = triangle(target_covariance)};
  }
};

/// Half the sum of squares and its derivatives: the gradient against differences, the Hessian against J' M J with a J
/// from differences, for random pairs at a random pose. M stays as it is at the pose.
template <SurfaceMetric Metric>
void check_derivatives(const Metric& metric) {
  for_all(20, [&](Rng& rng, int) {
    const SE3d T = random_motion(rng, 2.0, 2.0);
    const Eigen::Vector3d pivot(rng.normal(), rng.normal(), rng.normal());
    Vector6d gradient = Vector6d::Zero();
    Matrix6d hessian = Matrix6d::Zero();
    chainslam::detail::QuadSums sums;
    for (int i = 0; i < 3; ++i) {
      const TestPair pair(rng);
      const SurfacePair<double> here = pair.at(T, T.rotation());
      PairTerms<double> terms;
      metric.evaluate(here, terms);
      const Eigen::Matrix3d M = matrix(terms.information);
      const Eigen::Vector3d d(here.offset[0], here.offset[1], here.offset[2]);
      CHECK(terms.squared_residual == doctest::Approx(d.dot(M * d)));
      CHECK((Eigen::Vector3d(terms.pull[0], terms.pull[1], terms.pull[2]) - M * d).norm() <
            1e-12 * (1 + (M * d).norm()));
      // The motion that sums are about: the pivot shifts by v, the source turns about it by w, in the target's axes.
      const auto moved = [&](const Vector6d& xi) -> Eigen::Vector3d {
        const Eigen::Vector3d center = T * pivot;
        return SO3d::exp(xi.tail<3>()) * Eigen::Vector3d(T * pair.x - center) + center + xi.head<3>() - pair.q;
      };
      Eigen::Matrix<double, 3, 6> J;
      for (int k = 0; k < 6; ++k) {
        const Vector6d step = 1e-6 * Vector6d::Unit(k);
        J.col(k) = (moved(step) - moved(-step)) / 2e-6;
      }
      gradient += J.transpose() * M * d;
      hessian += J.transpose() * M * J;

      PairTerms<chainslam::detail::Quad> quad;  // the pair in lane 1, nothing in the others
      const auto in_lane = [](double value) {
        chainslam::detail::Quad lanes(0.0);
        lanes.set(1, value);
        return lanes;
      };
      for (std::size_t k = 0; k < 6; ++k) quad.information[k] = in_lane(terms.information[k]);
      for (std::size_t k = 0; k < 3; ++k) quad.pull[k] = in_lane(terms.pull[k]);
      quad.squared_residual = in_lane(terms.squared_residual);
      const Eigen::Vector3d y = T * pair.x - T * pivot;
      sums.add({in_lane(y[0]), in_lane(y[1]), in_lane(y[2])}, quad, in_lane(1.0), in_lane(terms.squared_residual));
    }
    CHECK((sums.total().gradient - gradient).norm() < 1e-7 * (1 + gradient.norm()));
    CHECK((sums.total().hessian - hessian).norm() < 1e-7 * (1 + hessian.norm()));
  });
}

}  // namespace

TEST_SUITE("registration/metrics") {
  TEST_CASE("gradients and Hessians of all metrics are those of differences") {
    check_derivatives(PointToPoint{});
    check_derivatives(PointToPlane{});
    check_derivatives(PlaneToPlane{});
    check_derivatives(DistributionToDistribution{});
  }

  TEST_CASE("the information from two normals is the inverse of the sum of two discs") {
    for_all(50, [](Rng& rng, int) {
      const double thickness = rng.uniform(1e-4, 1.0);
      TestPair pair(rng);
      if (rng.uniform() < 0.5) pair.source_normal = (pair.target_normal + 0.01 * random_unit(rng)).normalized();
      PairTerms<double> terms;
      PlaneToPlane{.thickness = thickness}.evaluate(pair.at(SE3d(), SO3d()), terms);
      const Eigen::Matrix3d sum = disc_of(pair.source_normal, thickness) + disc_of(pair.target_normal, thickness);
      const Eigen::Matrix3d expected = 2 * thickness * sum.inverse();
      CHECK((matrix(terms.information) - expected).norm() < 1e-9);
      pair.source_normal *= -1;  // signs do not matter
      PairTerms<double> turned;
      PlaneToPlane{.thickness = thickness}.evaluate(pair.at(SE3d(), SO3d()), turned);
      CHECK(turned.squared_residual == doctest::Approx(terms.squared_residual));
    });
  }

  TEST_CASE("where normals agree, plane to plane is the distance of the planes in metres") {
    Rng rng(1);
    TestPair pair(rng);
    pair.source_normal = pair.target_normal;
    pair.q = pair.x - 0.3 * pair.target_normal;
    PairTerms<double> terms;
    PlaneToPlane{}.evaluate(pair.at(SE3d(), SO3d()), terms);
    CHECK(terms.squared_residual == doctest::Approx(0.09));
  }

  TEST_CASE("two covariances give the inverse of their sum; discs give what normals give") {
    for_all(20, [](Rng& rng, int) {
      TestPair pair(rng);
      PairTerms<double> terms, from_normals;
      DistributionToDistribution{.scale = 1.0}.evaluate(pair.at(SE3d(), SO3d()), terms);
      const Eigen::Matrix3d inverse = (pair.source_covariance + pair.target_covariance).inverse();
      CHECK((matrix(terms.information) - inverse).norm() < 1e-10 * (1 + inverse.norm()));

      pair.source_covariance = disc_of(pair.source_normal, 1e-3);
      pair.target_covariance = disc_of(pair.target_normal, 1e-3);
      DistributionToDistribution{}.evaluate(pair.at(SE3d(), SO3d()), terms);
      PlaneToPlane{}.evaluate(pair.at(SE3d(), SO3d()), from_normals);
      CHECK((matrix(terms.information) - matrix(from_normals.information)).norm() < 1e-9);
    });
  }

  TEST_CASE("what has no normal, or no extent, tells little and is finite") {
    Rng rng(2);
    TestPair pair(rng);
    pair.source_normal.setZero();
    PairTerms<double> terms;
    PlaneToPlane{}.evaluate(pair.at(SE3d(), SO3d()), terms);
    CHECK(matrix(terms.information).trace() < 0.01);
    pair.target_normal.setZero();
    PointToPlane{}.evaluate(pair.at(SE3d(), SO3d()), terms);
    CHECK(terms.squared_residual == 0);
    PlaneToPlane{}.evaluate(pair.at(SE3d(), SO3d()), terms);
    CHECK((matrix(terms.information) - 1e-3 * Eigen::Matrix3d::Identity()).norm() < 1e-15);
    pair.source_covariance.setZero();
    pair.target_covariance.setZero();
    DistributionToDistribution{}.evaluate(pair.at(SE3d(), SO3d()), terms);
    CHECK(terms.squared_residual == 0);
  }
}

}  // namespace chainslam::test
