#include "chainslam/features/normals.hpp"

#include <doctest/doctest.h>

#include <array>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "chainslam/cloud/plane_fit.hpp"
#include "chainslam/core/symmetric_eigen.hpp"
#include "chainslam/core/thread_pool.hpp"
#include "chainslam/features/fpfh.hpp"
#include "chainslam/search/brute_force.hpp"
#include "chainslam/search/voxel_map.hpp"
#include "support/property.hpp"

namespace chainslam {
namespace {

PointCloud<float> sphere(Rng& rng, int count, double radius) {
  PointCloud<float> cloud;
  for (int i = 0; i < count; ++i)
    cloud.positions.push_back(
        (radius * Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal()).normalized()).cast<float>());
  return cloud;
}

/// Clumps of different density, a line, duplicates and points that are not finite: what makes a guessed reach wrong.
PointCloud<float> uneven(Rng& rng, int size) {
  PointCloud<float> cloud;
  const auto add = [&](const Eigen::Vector3d& p) { cloud.positions.emplace_back(p.cast<float>()); };
  const int clumps = 1 + static_cast<int>(rng.uniform_index(4));
  for (int clump = 0; clump < clumps; ++clump) {
    const Eigen::Vector3d middle(rng.uniform(-50, 50), rng.uniform(-50, 50), rng.uniform(-5, 5));
    const double spread = std::pow(10.0, rng.uniform(-2, 1));
    for (int i = 0; i < 10 * size; ++i)
      add(middle + spread * Eigen::Vector3d(rng.normal(), rng.normal(), 0.1 * rng.normal()));
  }
  for (int i = 0; i < size; ++i) add(Eigen::Vector3d(0.3 * i, 70, 0));
  const std::size_t before = cloud.size();
  for (int i = 0; i < size; ++i)
    cloud.positions.push_back(cloud.positions[static_cast<std::size_t>(rng.uniform_index(to_index(before)))]);
  cloud.positions.emplace_back(std::numeric_limits<float>::quiet_NaN(), 0.0f, 0.0f);
  cloud.positions.emplace_back(0.0f, std::numeric_limits<float>::infinity(), 0.0f);
  return cloud;
}

TEST_SUITE("features/normals") {
  TEST_CASE("a tree's own points, asked leaf by leaf, get what looking at every point gives") {
    test::for_all(40, [](Rng& rng, int size) {
      PointCloud<float> by_leaves = uneven(rng, size), by_brute_force = by_leaves;
      NormalOptions options{.neighbors = 3 + static_cast<Index>(rng.uniform_index(40)), .covariances = true};
      if (rng.uniform() < 0.3) options.radius = rng.uniform(0.05, 5);
      if (rng.uniform() < 0.2) options = {.neighbors = 0, .radius = rng.uniform(0.05, 2), .covariances = true};
      const NormalEstimates ours = estimate_normals(by_leaves, options);
      const NormalEstimates expected = estimate_normals(by_brute_force, BruteForce<>(by_brute_force), options);
      CHECK(ours.without_normal == expected.without_normal);
      REQUIRE(ours.covariances.size() == by_leaves.size());
      for (std::size_t i = 0; i < by_leaves.size(); ++i) {
        CHECK(by_leaves.normals[i].isZero(0) == by_brute_force.normals[i].isZero(0));
        // The same neighbours in another order: sums in double of float differences.
        const float trace = expected.covariances[i][0] + expected.covariances[i][3] + expected.covariances[i][5];
        for (std::size_t j = 0; j < 6; ++j)
          CHECK(std::abs(ours.covariances[i][j] - expected.covariances[i][j]) <= 1e-6f * trace);
        CHECK(std::abs(ours.curvature[i] - expected.curvature[i]) < 1e-5f);
      }
    });
  }

  TEST_CASE("covariances are those of the neighbours about their mean") {
    test::for_all(10, [](Rng& rng, int size) {
      PointCloud<float> cloud = uneven(rng, size);
      const NormalEstimates estimates = estimate_normals(cloud, {.neighbors = 12, .covariances = true});
      const BruteForce<> search(cloud);
      std::vector<Neighbor<float>> neighbors(12);
      for (std::size_t i = 0; i + 2 < cloud.size(); i += 7) {
        if (cloud.normals[i].isZero(0)) continue;
        const auto found = static_cast<std::size_t>(search.knn(cloud.positions[i], neighbors));
        Eigen::Matrix<double, 3, Eigen::Dynamic> points(3, static_cast<Eigen::Index>(found));
        for (std::size_t j = 0; j < found; ++j)
          points.col(static_cast<Eigen::Index>(j)) = search.position(neighbors[j].index).cast<double>();
        const Eigen::Vector3d mean = points.rowwise().mean();
        const Eigen::Matrix3d expected =
            (points.colwise() - mean) * (points.colwise() - mean).transpose() / static_cast<double>(found);
        const std::array<float, 6>& c = estimates.covariances[i];
        Eigen::Matrix3d ours;
        ours << c[0], c[1], c[2], c[1], c[3], c[4], c[2], c[4], c[5];
        CHECK((ours - expected).norm() <= 1e-5 * expected.trace());  // float coordinates to 70 m
        const Eigen::Vector3d normal = cloud.normals[i].cast<double>();
        CHECK(normal.dot(expected * normal) <= fit_plane(points).eigenvalues[0] + 1e-6 * expected.trace());
      }
    });
  }

  TEST_CASE("thousands of points in one place are no matter") {
    Rng rng(9);
    PointCloud<float> cloud = sphere(rng, 2000, 3.0);
    cloud.positions.resize(12'000, Eigen::Vector3f(3, 0, 0));
    const NormalEstimates estimates = estimate_normals(cloud, {.neighbors = 10});
    CHECK(estimates.without_normal >= 10'000);
    CHECK(estimates.without_normal < 10'200);  // and those whose neighbours are in that place
  }

  TEST_CASE("normals of a sphere point at a viewpoint in its middle") {
    Rng rng(1);
    PointCloud<float> cloud = sphere(rng, 5000, 5.0);
    const NormalEstimates estimates = estimate_normals(cloud, {.neighbors = 12});
    CHECK(estimates.without_normal == 0);
    double worst = 1;
    for (std::size_t i = 0; i < cloud.size(); ++i)
      worst = std::min(worst, -static_cast<double>(cloud.normals[i].dot(cloud.positions[i].normalized())));
    // Twelve neighbours of 5000 reach 0.5 m: about 3 deg of tilt at the worst, by their uneven spread.
    CHECK(worst > std::cos(0.1));
    for (const float curvature : estimates.curvature) CHECK(curvature < 0.02f);
  }

  TEST_CASE("noise of a plane tilts its normals by what the fit of n points predicts") {
    // 20 points over a disc of radius r, sigma across: tilt about sigma / (r / 2) / sqrt(20).
    Rng rng(2);
    PointCloud<float> cloud;
    for (int i = 0; i < 4000; ++i)
      cloud.positions.push_back(
          Eigen::Vector3d(rng.uniform(-5, 5), rng.uniform(-5, 5), 2 + 0.005 * rng.normal()).cast<float>());
    const NormalEstimates estimates = estimate_normals(cloud, {.neighbors = 20}, {0, 0, 100});
    CHECK(estimates.without_normal == 0);
    const double disc = std::sqrt(20 * 100 / (4000 * std::acos(-1.0)));
    const double expected = 0.005 / (disc / 2) / std::sqrt(20.0);
    double sum = 0;
    for (const Eigen::Vector3f& normal : cloud.normals) {
      CHECK(normal.norm() == doctest::Approx(1.0));
      CHECK(normal[2] > 0);
      sum += static_cast<double>(normal.head<2>().squaredNorm()) / 2;  // mean square of one component of the tilt
    }
    const double rms = std::sqrt(sum / 4000);
    CHECK(rms > 0.7 * expected);
    CHECK(rms < 1.5 * expected);
  }

  TEST_CASE("the viewpoint decides the sign") {
    PointCloud<float> cloud;
    for (int x = 0; x < 5; ++x)
      for (int y = 0; y < 5; ++y) cloud.positions.emplace_back(static_cast<float>(x), static_cast<float>(y), 0.0f);
    (void)estimate_normals(cloud, {.neighbors = 9}, {0, 0, 5});
    CHECK(cloud.normals[7].isApprox(Eigen::Vector3f(0, 0, 1)));
    (void)estimate_normals(cloud, {.neighbors = 9}, {0, 0, -5});
    CHECK(cloud.normals[7].isApprox(Eigen::Vector3f(0, 0, -1)));
  }

  TEST_CASE("all within a radius equals many nearest within that radius, over any search") {
    test::for_all(20, [](Rng& rng, int size) {
      PointCloud<float> by_radius = sphere(rng, 10 * size + 50, 3.0), by_both = by_radius, by_map = by_radius;
      const NormalEstimates a = estimate_normals(by_radius, BruteForce<>(by_radius), {.neighbors = 0, .radius = 1});
      const NormalEstimates b = estimate_normals(by_both, {.neighbors = 2000, .radius = 1});
      const VoxelMap<> map(by_map, {.voxel_size = 1, .max_points_per_voxel = 5000, .min_spacing = 0});
      const NormalEstimates c = estimate_normals(by_map, map, {.neighbors = 0, .radius = 1});
      CHECK(a.without_normal == b.without_normal);
      CHECK(a.without_normal == c.without_normal);
      for (std::size_t i = 0; i < by_both.size(); ++i) {
        CHECK((by_radius.normals[i] - by_both.normals[i]).norm() < 1e-4f);  // sums in another order
        CHECK((by_radius.normals[i] - by_map.normals[i]).norm() < 1e-4f);
      }
    });
  }

  TEST_CASE("isolated points, lines, duplicates and NaN get the zero vector and are counted") {
    PointCloud<float> cloud;
    const float nan = std::numeric_limits<float>::quiet_NaN();
    for (int i = 0; i < 8; ++i) cloud.positions.emplace_back(static_cast<float>(i) * 0.1f, 0.0f, 0.0f);  // a line
    for (int i = 0; i < 8; ++i) cloud.positions.emplace_back(50.0f, 0.0f, 0.0f);                         // one place
    cloud.positions.emplace_back(0.0f, 90.0f, 0.0f);                                                     // alone
    cloud.positions.emplace_back(nan, 0.0f, 0.0f);
    const NormalEstimates estimates = estimate_normals(cloud, {.neighbors = 6, .radius = 2});
    CHECK(estimates.without_normal == 18);
    for (const Eigen::Vector3f& normal : cloud.normals) CHECK(normal == Eigen::Vector3f(0, 0, 0));
    PointCloud<float> none;
    CHECK(estimate_normals(none).without_normal == 0);
    CHECK(none.normals.empty());
  }

  TEST_CASE("any number of threads gives the same bits") {
    Rng rng(4);
    PointCloud<float> serial = sphere(rng, 3000, 4.0);
    const NormalEstimates expected = estimate_normals(serial, {.neighbors = 10});
    for (const Index threads : {1, 2, 5}) {
      PointCloud<float> cloud = serial;
      const ThreadPool pool(threads);
      const NormalEstimates estimates = estimate_normals(cloud, {.neighbors = 10}, {0, 0, 0}, pool);
      CHECK(cloud.normals == serial.normals);
      CHECK(estimates.planarity == expected.planarity);
      CHECK(estimates.curvature == expected.curvature);
    }
  }

  TEST_CASE("normals made on demand are the same bits, whoever asks and in whatever order") {
    test::for_all(10, [](Rng& rng, int size) {
      const PointCloud<float> bare = uneven(rng, size);
      PointCloud<float> at_once = bare;
      const NormalOptions options{.neighbors = 10, .radius = rng.uniform(0.5, 50)};
      const Eigen::Vector3d viewpoint(rng.normal(), rng.normal(), rng.normal());
      const NormalEstimates all = estimate_normals(at_once, options, viewpoint);
      const OrientedOnDemand on_demand(bare, options, viewpoint);
      CHECK(on_demand.size() == bare.size() - 2);              // two are not finite
      const Index count = to_index(bare.size()), step = 7919;  // a prime, so that all get their turn
      std::atomic<Index> without = 2, differ = 0;
      ThreadPool(3).for_chunks(count, 16, [&](Index begin, Index end) {
        for (Index k = begin; k < end; ++k) {
          const auto i = static_cast<Index>(std::int64_t{k} * step % count);
          if (!on_demand.search().contains(i)) continue;
          const auto at = static_cast<std::size_t>(i);
          const bool same = on_demand.normal(i) == at_once.normals[at] && on_demand.position(i) == bare.positions[at];
          differ += same ? 0 : 1;
          without += on_demand.normal(i).isZero(0) ? 1 : 0;
        }
      });
      CHECK(differ == 0);
      CHECK(without == all.without_normal);
    });
    CHECK_THROWS_AS(OrientedOnDemand({}, {.radius = 0}), std::invalid_argument);
    CHECK(OrientedOnDemand({}).size() == 0);
  }

  TEST_CASE("eight eigenproblems at a time agree with one at a time") {
    test::for_all(200, [](Rng& rng, int) {
      std::array<Eigen::Matrix3d, detail::plane_lanes> matrices;
      detail::SymmetricLanes lanes{};
      for (int lane = 0; lane < detail::plane_lanes; ++lane) {
        const Eigen::Matrix3d axes =
            Eigen::Quaterniond(rng.normal(), rng.normal(), rng.normal(), rng.normal()).normalized().toRotationMatrix();
        const double scale = std::pow(10.0, rng.uniform(-8, 8));
        // A ball, a disc, a line, nothing, and anything.
        const std::array<Eigen::Vector3d, 5> shapes{Eigen::Vector3d(1, 1, 1),
                                                    {1e-9, 1, 1},
                                                    {1e-9, 1e-9, 1},
                                                    {0, 0, 0},
                                                    {rng.uniform(), rng.uniform(), rng.uniform()}};
        const Eigen::Vector3d values = scale * shapes[static_cast<std::size_t>(rng.uniform_index(5))];
        Eigen::Matrix3d& m = matrices[static_cast<std::size_t>(lane)];
        m = axes * values.asDiagonal() * axes.transpose();
        lanes.xx[lane] = m(0, 0), lanes.xy[lane] = m(1, 0), lanes.xz[lane] = m(2, 0);
        lanes.yy[lane] = m(1, 1), lanes.yz[lane] = m(2, 1), lanes.zz[lane] = m(2, 2);
      }
      detail::LeastEigenLanes eigen{};
      detail::least_eigenvectors(lanes, eigen);
      for (int lane = 0; lane < detail::plane_lanes; ++lane) {
        const Eigen::Matrix3d& m = matrices[static_cast<std::size_t>(lane)];
        const SymmetricEigen3 expected = symmetric_eigen(m);
        const double tolerance = 1e-14 * m.norm() + 1e-300;
        Eigen::Vector3d v;
        for (std::size_t i = 0; i < 3; ++i) {
          CHECK(std::abs(eigen.values[i][lane] - expected.values[static_cast<Eigen::Index>(i)]) <= tolerance);
          v[static_cast<Eigen::Index>(i)] = eigen.vector[i][lane];
        }
        CHECK(v.norm() == doctest::Approx(1.0).epsilon(1e-14));
        CHECK((m * v - expected.values[0] * v).norm() <= 10 * tolerance);
      }
    });
  }

  TEST_CASE("options that name no neighbourhood are refused") {
    PointCloud<float> cloud;
    CHECK_THROWS_AS(estimate_normals(cloud, {.neighbors = 0}), std::invalid_argument);
    CHECK_THROWS_AS(estimate_normals(cloud, {.neighbors = -1}), std::invalid_argument);
    CHECK_THROWS_AS(estimate_normals(cloud, {.radius = 0}), std::invalid_argument);
  }
}

}  // namespace
}  // namespace chainslam
