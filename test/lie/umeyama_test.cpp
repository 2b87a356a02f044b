#include "chainslam/lie/umeyama.hpp"

#include <doctest/doctest.h>

#include <limits>
#include <vector>

#include "lie/laws.hpp"

namespace chainslam::test {
namespace {

using Points = std::vector<Eigen::Vector3d>;

Points random_points(Rng& rng, int count) {
  Points points(static_cast<std::size_t>(count));
  for (Eigen::Vector3d& p : points) p = random_tangent<Eigen::Vector3d>(rng, 20.0);
  return points;
}

Points moved(const Points& points, const Sim3d& T) {
  Points result;
  for (const Eigen::Vector3d& p : points) result.push_back(T * p);
  return result;
}

double sum_of_squares(const Points& source, const Points& target, const Sim3d& T) {
  double sum = 0;
  for (std::size_t i = 0; i < source.size(); ++i) sum += (target[i] - T * source[i]).squaredNorm();
  return sum;
}

}  // namespace

TEST_SUITE("lie/umeyama") {
  TEST_CASE("finds the motion that made the target from the source") {
    for_all(200, [](Rng& rng, int size) {
      const Points source = random_points(rng, size + 2);
      const Sim3d similarity = random_point<Sim3d>(rng);
      const Sim3d rigid(similarity.rigid());
      const auto with_scale = umeyama(source, moved(source, similarity), true);
      const auto without = umeyama(source, moved(source, rigid), false);
      REQUIRE(with_scale.has_value());
      REQUIRE(without.has_value());
      CHECK(near(with_scale->local(similarity), Sim3d::Tangent::Zero(), 1e-10));
      CHECK(near(without->local(rigid), Sim3d::Tangent::Zero(), 1e-10));
      CHECK(without->scale() == 1.0);
    });
  }

  TEST_CASE("with noise, no neighbouring motion is better") {
    for_all(50, [](Rng& rng, int size) {
      const Points source = random_points(rng, size + 10);
      Points target = moved(source, random_point<Sim3d>(rng));
      for (Eigen::Vector3d& p : target) p += random_tangent<Eigen::Vector3d>(rng, 0.5);
      const auto best = umeyama(source, target, true);
      REQUIRE(best.has_value());
      const double least = sum_of_squares(source, target, *best);
      for (int i = 0; i < 20; ++i) {
        const Sim3d other = best->retract(random_tangent<Sim3d::Tangent>(rng, 1e-3));
        CHECK(sum_of_squares(source, target, other) >= least * (1 - 1e-12));
      }
    });
  }

  TEST_CASE("Umeyama's own example (1991, section IV), whose best orthogonal matrix would be a reflection") {
    // The paper works in the plane; in space the mirrored triangle can be turned over, so the fit is better than its
    // 0.053 and the rotation is proper all the same.
    const Points source{{0, 0, 0}, {1, 0, 0}, {0, 2, 0}};
    const Points target{{0, 0, 0}, {-1, 0, 0}, {0, 2, 0}};
    const auto T = umeyama(source, target, true);
    REQUIRE(T.has_value());
    CHECK(T->rotation().matrix().determinant() == doctest::Approx(1.0).epsilon(1e-14));
    CHECK(sum_of_squares(source, target, *T) < 1e-28);
  }

  TEST_CASE("a mirrored solid gives a proper rotation, the best of all") {
    for_all(50, [](Rng& rng, int size) {
      const Points source = random_points(rng, size + 10);
      Points target = source;
      for (Eigen::Vector3d& p : target) p.x() = -p.x();
      const auto T = umeyama(source, target, false);
      REQUIRE(T.has_value());
      CHECK(T->rotation().matrix().determinant() == doctest::Approx(1.0).epsilon(1e-14));
      const double least = sum_of_squares(source, target, *T);
      for (int i = 0; i < 50; ++i) {
        const Sim3d other(random_point<SO3d>(rng), T->translation(), 1.0);
        CHECK(sum_of_squares(source, target, other) >= least);
      }
    });
  }

  TEST_CASE("points of a plane are enough, points of a line are not") {
    Rng rng(3);
    const Sim3d T = random_point<Sim3d>(rng);
    Points plane = random_points(rng, 5);
    for (Eigen::Vector3d& p : plane) p.z() = 4;
    const auto found = umeyama(plane, moved(plane, T), true);
    REQUIRE(found.has_value());
    CHECK(near(found->local(T), Sim3d::Tangent::Zero(), 1e-12));

    Points line;
    for (int i = 0; i < 50; ++i) line.push_back(Eigen::Vector3d(5, 6, 7) + i * Eigen::Vector3d(0.3, -0.4, 0.1));
    CHECK_FALSE(umeyama(line, moved(line, T), true).has_value());
    line.push_back(line.front() + Eigen::Vector3d(0.02, 0.02, 0.02));  // 2 cm off a line of 25 m tell the roll
    CHECK(umeyama(line, moved(line, T), true).has_value());
  }

  TEST_CASE("too few points, one place and NaN give nothing; different lengths are the caller's mistake") {
    const Points two{{0, 0, 0}, {1, 2, 3}};
    const Points same(7, Eigen::Vector3d(1, 2, 3));
    Points nan{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    const Points good = nan;
    nan[2].y() = std::numeric_limits<double>::quiet_NaN();
    CHECK_FALSE(umeyama({}, {}, false).has_value());
    CHECK_FALSE(umeyama(two, two, false).has_value());
    CHECK_FALSE(umeyama(same, same, true).has_value());
    CHECK_FALSE(umeyama(good, nan, true).has_value());
    CHECK_FALSE(umeyama(nan, good, false).has_value());
    CHECK_THROWS_AS((void)umeyama(two, good, false), std::invalid_argument);
  }

  TEST_CASE("points 5000 km from the origin (Earth-centred coordinates) lose nothing that matters") {
    Rng rng(5);
    const Points source = random_points(rng, 100);
    const Sim3d T(random_point<SO3d>(rng), Eigen::Vector3d(4.1e6, 6.2e5, 4.8e6), 1.0);
    const auto found = umeyama(source, moved(source, T), false);
    REQUIRE(found.has_value());
    for (const Eigen::Vector3d& p : source) CHECK(near(*found * p, T * p, 1e-8));
  }
}

}  // namespace chainslam::test
