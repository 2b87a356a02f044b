#include "chainslam/odometry/detail/scan_planes.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/core/thread_pool.hpp"
#include "chainslam/search/brute_force.hpp"
#include "chainslam/search/ikd_tree.hpp"
#include "chainslam/search/voxel_map.hpp"
#include "support/property.hpp"
#include "support/threads_cases.hpp"

namespace chainslam::detail {
namespace {

constexpr std::size_t five = 5;
using Points = std::array<Eigen::Vector3d, five>;

Eigen::Vector3d random_vector(Rng& rng, double size) {
  return size * Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal());
}
SE3d random_pose(Rng& rng, double turned, double moved) {
  return {SO3d::exp(random_vector(rng, turned)), random_vector(rng, moved)};
}

/// Of a wall, a corner, a line or nothing in particular, in float.
Points some_neighbors(Rng& rng, const Eigen::Vector3d& centre) {
  const std::array<Eigen::Vector3d, 4> shapes{
      Eigen::Vector3d(0.5, 0.4, 0.01), {0.4, 0.3, 0.06}, {0.6, 0.02, 0.01}, {0.3, 0.3, 0.3}};
  const Eigen::Vector3d shape = shapes[static_cast<std::size_t>(rng.uniform_index(4))];
  const SO3d R = SO3d::exp(random_vector(rng, 2));
  Points points;
  for (Eigen::Vector3d& p : points)
    p = (centre + R * Eigen::Vector3d(random_vector(rng, 1).cwiseProduct(shape))).cast<float>().cast<double>();
  return points;
}

constexpr PlaneRule plane_rule{
    .max_neighbor_distance = 2.2, .max_deviation = 0.1, .min_width = 0.1, .least_noise = 0.01};

MatchedPlane one_by_one(const Points& points, const PlaneRule& rule, const Eigen::Vector3d& origin) {
  const PlaneFit fit = fit_plane(std::span<const Eigen::Vector3d>(points));
  MatchedPlane plane = centred_plane(fit, points, rule);
  plane.anchor = (fit.centroid - origin).cast<float>();
  return plane;
}

/// The sums in double, match by match, as the comment on `plane_equations` has it.
template <class Weight>
PlaneEquations literal_equations(const std::vector<Eigen::Vector3f>& scan, const std::vector<MatchedPlane>& planes,
                                 const Eigen::Vector3d& origin, const SE3d& T, const ResidualGate& gate,
                                 const Weight& weight) {
  PlaneEquations sum;
  for (std::size_t i = 0; i < scan.size(); ++i) {
    const Eigen::Vector3d n = planes[i].normal.cast<double>(), p = scan[i].cast<double>();
    const double r = n.dot(T * p - origin - planes[i].anchor.cast<double>());
    if (n.squaredNorm() == 0 || std::abs(r) > std::max(gate.per_root_of_range * std::sqrt(p.norm()), gate.least))
      continue;
    const auto row = [&](const Eigen::Vector3d& direction) {
      const Eigen::Vector3d m = T.rotation().inverse() * direction;
      Vector6d J;
      J << m, p.cross(m);
      return J;
    };
    const Eigen::Vector3d side = planes[i].long_side.cast<double>();
    const Vector6d J = row(n), along = row(side), across = row(n.cross(side));
    const double w = weight(r * r);
    sum.hessian += w * J * J.transpose();
    sum.noise += w * static_cast<double>(planes[i].long_tilt) * along * along.transpose() +
                 w * static_cast<double>(planes[i].short_tilt) * across * across.transpose();
    sum.gradient += w * r * J;
    sum.weight += w;
    sum.squared_residuals += w * r * r;
    sum.squared_ranges += w * p.squaredNorm();
    ++sum.matches;
  }
  return sum;
}

bool close(const Matrix6d& a, const Matrix6d& b, double tolerance) { return (a - b).norm() <= tolerance * b.norm(); }

/// Points of the floor and two walls of a yard, with noise.
std::vector<Eigen::Vector3f> yard(Rng& rng, int count) {
  std::vector<Eigen::Vector3f> points;
  for (int i = 0; i < count; ++i) {
    Eigen::Vector3d p(rng.uniform(-10, 10), rng.uniform(-10, 10), rng.uniform(0, 6));
    const int wall = static_cast<int>(rng.uniform_index(3));
    p[wall] = (wall == 2 ? 0.0 : 10.0) + rng.normal(0, 0.02);
    points.push_back(p.cast<float>());
  }
  return points;
}

}  // namespace

TEST_SUITE("odometry/scan_planes") {
  TEST_CASE("planes fitted in lanes are those fitted one by one") {
    int planes = 0, none = 0;
    test::for_all(600, [&](Rng& rng, int) {
      const Eigen::Vector3d origin = random_vector(rng, 300).cast<float>().cast<double>();
      std::vector<Points> sets;
      const std::size_t count = 1 + static_cast<std::size_t>(rng.uniform_index(lane_count));
      PlaneFits<five> fits;
      for (std::size_t i = 0; i < count; ++i) {
        sets.push_back(some_neighbors(rng, origin + random_vector(rng, 30)));
        CHECK_FALSE(fits.full());
        fits.add(i);
        for (const Eigen::Vector3d& p : sets[i]) fits.add_neighbor((p - origin).cast<float>());
      }
      CHECK(fits.full() == (count == lane_count));
      std::size_t taken = 0;
      fits.fit(plane_rule, [&](std::size_t i, const MatchedPlane& plane) {
        CHECK(i == taken++);
        const MatchedPlane expected = one_by_one(sets[i], plane_rule, origin);
        // Whether it is a plane may turn on rounding: not by a hair that is wider than that.
        PlaneRule strict = plane_rule, lax = plane_rule;
        strict.max_deviation -= 1e-4, strict.min_width += 1e-4, lax.max_deviation += 1e-4, lax.min_width -= 1e-4;
        if (plane.normal.isZero(0)) {
          ++none;
          CHECK(one_by_one(sets[i], strict, origin).normal.isZero(0));
          return;
        }
        ++planes;
        CHECK_FALSE(one_by_one(sets[i], lax, origin).normal.isZero(0));
        if (expected.normal.isZero(0)) return;
        CHECK(plane.normal.norm() == doctest::Approx(1).epsilon(1e-5));
        CHECK(plane.normal.cross(expected.normal).norm() < 2e-4F);
        CHECK((plane.anchor - expected.anchor).norm() < 1e-3F);
        CHECK(plane.long_tilt == doctest::Approx(expected.long_tilt).epsilon(1e-2));
        CHECK(plane.short_tilt == doctest::Approx(expected.short_tilt).epsilon(1e-2));
        CHECK(std::abs(plane.long_side.dot(plane.normal)) < 1e-5F);
      });
      CHECK(taken == count);
      fits.fit(plane_rule, [](std::size_t, const MatchedPlane&) { CHECK(false); });
    });
    // However wide the lanes, and however many runs.
    CHECK(planes > (planes + none) / 5);
    CHECK(none > (planes + none) / 5);
  }

  TEST_CASE("sums in lanes are those of one match after the other") {
    test::for_all(50, [](Rng& rng, int) {
      const SE3d T = random_pose(rng, 1, 1000);
      const Eigen::Vector3d origin = (T.translation() + random_vector(rng, 1)).cast<float>().cast<double>();
      const std::size_t count = 1 + static_cast<std::size_t>(rng.uniform_index(1500));
      const bool noisy = rng.uniform() < 0.7;
      std::vector<Eigen::Vector3f> scan;
      std::vector<MatchedPlane> planes;
      std::vector<PlaneBlock> blocks((count + PlaneBlock::width - 1) / PlaneBlock::width);
      for (std::size_t i = 0; i < count; ++i) {
        scan.push_back(random_vector(rng, 20).cast<float>());
        MatchedPlane plane;
        if (rng.uniform() < 0.8) {
          const Eigen::Vector3d n = random_vector(rng, 1).normalized();
          plane.normal = n.cast<float>();
          plane.anchor = (T * scan.back().cast<double>() - origin + rng.normal(0, 0.3) * n).cast<float>();
          plane.long_side = n.unitOrthogonal().cast<float>();
          plane.long_tilt = noisy ? static_cast<float>(rng.uniform(0, 1e-3)) : 0.0F;
          plane.short_tilt = noisy ? static_cast<float>(rng.uniform(0, 1e-2)) : 0.0F;
        }
        planes.push_back(plane);
        blocks[i / PlaneBlock::width].set_point(i % PlaneBlock::width, scan.back().cast<double>());
        blocks[i / PlaneBlock::width].set_plane(i % PlaneBlock::width, plane);
      }
      const ResidualGate gate{0.1, rng.uniform(0, 0.5)};
      const auto weight = [](double squared) { return GemanMcClure{}.weight(squared / 0.04); };
      const PlaneEquations expected = literal_equations(scan, planes, origin, T, gate, weight);
      const PlaneEquations found = plane_equations(blocks, origin, T, gate, weight, Serial{});
      CHECK(std::abs(found.matches - expected.matches) <= 1);  // one may lie on the gate
      if (found.matches != expected.matches) return;
      CHECK(close(found.hessian, expected.hessian, 1e-5));
      CHECK((found.noise - expected.noise).norm() <= 1e-5 * expected.noise.norm());
      CHECK((found.gradient - expected.gradient).norm() <=
            1e-4 * std::sqrt(expected.hessian.trace() * expected.weight) * 0.3 + 1e-12);
      CHECK(found.weight == doctest::Approx(expected.weight).epsilon(1e-4));
      CHECK(found.squared_residuals == doctest::Approx(expected.squared_residuals).epsilon(1e-3));
      CHECK(found.squared_ranges == doctest::Approx(expected.squared_ranges).epsilon(1e-4));
    });
    const PlaneEquations none = plane_equations(
        {}, {0, 0, 0}, SE3d(), {1, 1}, [](double) { return 1.0; }, Serial{});
    CHECK(none.matches == 0);
    CHECK(none.hessian.isZero(0));
  }

  TEST_CASE_TEMPLATE("kept neighbours are the nearest wherever the place goes", Map, BruteForce<float>, IkdTree<float>,
                     VoxelMap<float>) {
    int kept = 0, changed = 0;
    test::for_all(20, [&](Rng& rng, int) {
      Map map;
      map.insert(yard(rng, 2000));
      for (int place = 0; place < 20; ++place) {
        KeptNeighbors<float, five> neighbors;
        using Change = typename KeptNeighbors<float, five>::Change;
        Eigen::Vector3d p(rng.uniform(-10, 10), rng.uniform(-10, 10), rng.uniform(-1, 7));
        float limit = 2.2F;
        std::vector<std::array<float, 3>> before;
        for (int step = 0; step < 12; ++step) {
          p += random_vector(rng, std::pow(10.0, rng.uniform(-4, -0.5)));
          if (rng.uniform() < 0.1) limit = static_cast<float>(rng.uniform(0.3, 2.5));
          const Eigen::Vector3f at = p.cast<float>();
          const Change change = neighbors.find(map, at, limit);
          std::array<Neighbor<float>, five> expected;
          if (map.knn(at, expected, limit) < 5) {
            CHECK(change == Change::none);
            before.clear();
            continue;
          }
          REQUIRE(change != Change::none);
          std::vector<float> now, right;  // squared distances: points may be equal
          std::vector<std::array<float, 3>> places;
          neighbors.for_each([&](const Eigen::Vector3f& q) { places.push_back({q[0], q[1], q[2]}); });
          for (const auto& q : places) now.push_back((Eigen::Vector3f(q[0], q[1], q[2]) - at).squaredNorm());
          for (const Neighbor<float>& neighbor : expected) right.push_back(neighbor.squared_distance);
          std::ranges::sort(now);
          std::ranges::sort(places);
          REQUIRE(now.size() == right.size());
          for (std::size_t i = 0; i < five; ++i) CHECK(now[i] == doctest::Approx(right[i]).epsilon(1e-5));
          CHECK((change == Change::same) == (places == before));
          ++(change == Change::same ? kept : changed);
          before = places;
        }
      }
    });
    CHECK(kept > 500);
    CHECK(changed > 500);
  }

  THREADS_TEST_CASE("odometry/scan_planes", "threads change no bit of the sums") {
    Rng rng(1);
    IkdTree<float> map;
    map.insert(yard(rng, 2000));
    const std::vector<Eigen::Vector3f> scan = yard(rng, 3001);
    const auto sums = [&](const auto& executor) {
      ScanPlanes<float, five> planes(scan, {0, 0, 0});
      PlaneEquations last;
      for (const double off : {0.1, 0.05, 0.04}) {
        const SE3d T(SO3d::exp({0, 0, 0.1 * off}), {off, 0, 0});
        planes.match(scan, map, T, plane_rule, executor);
        last = planes.equations(
            T, {0.1, 0.1}, [](double) { return 1.0; }, executor);
      }
      return last;
    };
    const PlaneEquations serial = sums(Serial{}), threaded = sums(ThreadPool(3));
    CHECK(serial.matches > 1500);
    CHECK(serial.matches == threaded.matches);
    CHECK(serial.hessian == threaded.hessian);
    CHECK(serial.noise == threaded.noise);
    CHECK(serial.gradient == threaded.gradient);
  }
}

}  // namespace chainslam::detail
