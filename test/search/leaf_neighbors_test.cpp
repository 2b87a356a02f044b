#include "chainslam/search/leaf_neighbors.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/search/brute_force.hpp"
#include "chainslam/search/kd_tree.hpp"
#include "support/property.hpp"

namespace chainslam {
namespace {

TEST_SUITE("search/leaf_neighbors") {
  TEST_CASE_TEMPLATE("every point of a tree gets its k nearest once", Scalar, float, double) {
    using Vector = Eigen::Matrix<Scalar, 3, 1>;
    test::for_all(40, [](Rng& rng, int size) {
      std::vector<Vector> points;
      for (int i = 0; i < 20 * size; ++i) {  // thin and thick by turns
        const double spread = std::pow(4.0, i / (4 * size));
        points.push_back(
            (spread * Eigen::Vector3d(rng.normal(), rng.normal(), 0.05 * rng.normal())).template cast<Scalar>());
      }
      points.push_back(Vector::Constant(std::numeric_limits<Scalar>::quiet_NaN()));
      const KdTree<Scalar> tree(points);
      const BruteForce<Scalar> all(points);
      const auto k = static_cast<std::size_t>(rng.uniform_index(60));  // 0: all within
      const Scalar within = k == 0 || rng.uniform() < 0.3 ? static_cast<Scalar>(rng.uniform(0.1, 3))
                                                          : std::numeric_limits<Scalar>::infinity();
      LeafNeighbors<KdTree<Scalar>> neighbors(tree, k, within);
      CHECK(neighbors.holds(points));
      std::vector<int> visits(points.size(), 0);
      std::vector<Neighbor<Scalar>> expected;
      for (Index leaf = 0; leaf < neighbors.leaves(); ++leaf)
        neighbors.search(leaf, [&](Index i, std::size_t count, auto&& offset) {
          ++visits[static_cast<std::size_t>(i)];
          std::vector<Scalar> found;
          for (std::size_t j = 0; j < count; ++j)
            found.push_back(Vector(offset(j, 0), offset(j, 1), offset(j, 2)).squaredNorm());
          std::sort(found.begin(), found.end());
          all.within(points[static_cast<std::size_t>(i)], within, expected);
          std::vector<Scalar> wanted;
          for (const auto& neighbor : expected) wanted.push_back(neighbor.squared_distance);
          std::sort(wanted.begin(), wanted.end());
          if (k > 0) wanted.resize(std::min(k, wanted.size()));
          REQUIRE(found.size() == wanted.size());
          for (std::size_t j = 0; j < found.size(); ++j)
            CHECK(std::abs(found[j] - wanted[j]) <= 8 * std::numeric_limits<Scalar>::epsilon() * wanted[j]);
        });
      CHECK(std::count(visits.begin(), visits.end(), 1) == static_cast<std::ptrdiff_t>(tree.size()));
      CHECK(visits.back() == 0);
    });
  }

  TEST_CASE("a tree of other points is told") {
    Rng rng(3);
    std::vector<Eigen::Vector3f> points;
    for (int i = 0; i < 100; ++i)
      points.emplace_back(Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal()).cast<float>());
    const KdTree<> tree(points);
    const LeafNeighbors<KdTree<>> neighbors(tree, 5, 1);
    CHECK(neighbors.holds(points));
    std::vector<Eigen::Vector3f> others = points;
    others[50][1] += 1e-3f;
    CHECK_FALSE(neighbors.holds(others));
    others = points;
    others.pop_back();
    CHECK_FALSE(neighbors.holds(others));
  }
}

}  // namespace
}  // namespace chainslam
