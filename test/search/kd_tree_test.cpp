#include "chainslam/search/kd_tree.hpp"

#include <doctest/doctest.h>

#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "chainslam/search/brute_force.hpp"
#include "chainslam/search/indexed_cloud.hpp"
#include "search/search_laws.hpp"
#include "support/property.hpp"

namespace chainslam {
namespace {

static_assert(FixedSizeSearch<KdTree<double, 2>>);

std::vector<Eigen::Vector3f> flat_points(Rng& rng, int count) {
  std::vector<Eigen::Vector3f> points;
  for (int i = 0; i < count; ++i)
    points.push_back(Eigen::Vector3d(rng.uniform(-9, 9), rng.uniform(-9, 9), rng.uniform(-1, 1)).cast<float>());
  return points;
}

TEST_SUITE("search/kd_tree") {
  TEST_CASE("position gives back every point, whatever the number of points") {
    test::for_all(120, [](Rng& rng, int size) {
      const auto points = flat_points(rng, size);  // 1 to 100: leaves of every filling
      const KdTree<> tree(points);
      for (std::size_t i = 0; i < points.size(); ++i) CHECK(tree.position(static_cast<Index>(i)) == points[i]);
    });
  }

  TEST_CASE("a large tree is exact too") {
    Rng rng(3);
    const auto points = flat_points(rng, 50'000);
    const KdTree<> tree(points);
    const BruteForce<> reference(points);
    for (int i = 0; i < 100; ++i) {
      const Eigen::Vector3f query = flat_points(rng, 1)[0];
      std::array<Neighbor<float>, 8> ours, theirs;
      REQUIRE(tree.knn(query, ours) == 8);
      reference.knn(query, theirs);
      for (std::size_t k = 0; k < 8; ++k) CHECK(ours[k].index == theirs[k].index);
    }
  }

  TEST_CASE("the same cloud gives the same answers in the same order") {
    const std::vector<Eigen::Vector3f> points(100, {1, 1, 1});  // nothing but ties
    const KdTree<> a(points), b(points);
    std::array<Neighbor<float>, 10> from_a, from_b;
    a.knn({0, 0, 0}, from_a);
    b.knn({0, 0, 0}, from_b);
    for (std::size_t k = 0; k < 10; ++k) CHECK(from_a[k].index == from_b[k].index);
  }

  TEST_CASE("in two dimensions it agrees with brute force, too") {
    test::for_all(60, [](Rng& rng, int size) {
      std::vector<Eigen::Vector2d> points;
      for (int i = 0; i < 20 * size; ++i) points.emplace_back(rng.uniform(-9, 9), std::round(rng.uniform(-9, 9)));
      const KdTree<double, 2> tree(points);
      const BruteForce<double, 2> reference(points);
      const double infinity = std::numeric_limits<double>::infinity();
      for (const Index k : {1, 2, 8, 9, 30})
        test::check_query(tree, reference, {rng.uniform(-10, 10), rng.uniform(-10, 10)}, k, infinity, infinity);
    });
  }

  TEST_CASE("a split leaves as many points on either side as it may, on their side of its plane") {
    using Point = detail::TreePoint<float, 3, Index>;
    Rng rng(5);
    for (const int count : {2, 33, 97, 600, 20'000})
      for (const int values : {1, 2, 50, 1'000'000})  // of equal points no plane parts any
        for (const double skew : {1.0, 12.0}) {
          std::vector<Point> points, scratch(static_cast<std::size_t>(count));
          for (Index i = 0; i < count; ++i)
            points.push_back({{std::floor(static_cast<float>(values * std::pow(rng.uniform(0, 1), skew))), 0, 0}, i});
          const std::vector<Point> before = points;
          const auto n = points.size();
          for (const std::size_t at_least : {n / 4, n / 2, n - n / 8 - 1}) {
            const std::size_t most = std::max(at_least, n - n / 4), least = std::max<std::size_t>(at_least, 1);
            const auto split = detail::split_points<Point>(points, scratch, least, most);
            REQUIRE(split.below >= least);
            REQUIRE(split.below <= most);
            std::vector<bool> seen(n);
            bool right = split.axis == 0;
            for (std::size_t i = 0; i < n; ++i) {
              const auto place = static_cast<std::size_t>(points[i].payload);
              right = right && !seen[place] && points[i].at == before[place].at &&
                      (i < split.below ? points[i].at[0] <= split.at : points[i].at[0] >= split.at);
              seen[place] = true;
            }
            CHECK(right);
          }
        }
  }

  TEST_CASE("an unbuilt tree finds nothing") {
    std::array<Neighbor<float>, 2> out;
    CHECK(KdTree<>().knn({0, 0, 0}, out) == 0);
    CHECK(KdTree<>().size() == 0);
  }
}

TEST_SUITE("search/indexed_cloud") {
  TEST_CASE("answers with the cloud's own indices, positions and normals, also after being moved") {
    PointCloud<float> cloud;
    cloud.positions = {{0, 0, 0}, {1, 0, 0}, {5, 5, 5}};
    cloud.normals = {{0, 0, 1}, {0, 1, 0}, {1, 0, 0}};
    IndexedCloud<> first(cloud);
    const IndexedCloud<> target = std::move(first);
    std::array<Neighbor<float>, 2> out;
    REQUIRE(target.knn({0.9f, 0, 0}, out, 1.0f) == 2);
    CHECK(out[0].index == 1);
    CHECK(target.position(out[0].index) == cloud.positions[1]);
    CHECK(target.normal(out[0].index) == cloud.normals[1]);
    CHECK(target.size() == 3);
    CHECK(target.has_normals());
    CHECK(target.cloud().positions == cloud.positions);
    std::vector<Neighbor<float>> near;
    target.within({5, 5, 4}, 1.0f, near);
    REQUIRE(near.size() == 1);
    CHECK(near[0].index == 2);
  }

  TEST_CASE("works over any search") {
    PointCloud<float> cloud;
    cloud.positions = {{0, 0, 0}, {1, 0, 0}};
    const IndexedCloud<BruteForce<float>> target(cloud);
    std::array<Neighbor<float>, 1> out;
    CHECK(target.knn({2, 0, 0}, out) == 1);
    CHECK(out[0].index == 1);
    CHECK_FALSE(target.has_normals());
  }
}

}  // namespace
}  // namespace chainslam
