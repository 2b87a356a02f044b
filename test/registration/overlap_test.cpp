#include "chainslam/registration/alignment_checks.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <limits>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/search/kd_tree.hpp"
#include "registration/scenes.hpp"
#include "support/property.hpp"
#include "support/threads_cases.hpp"

namespace chainslam::test {

TEST_SUITE("registration/overlap") {
  TEST_CASE("counts the pairs that comparing all with all finds") {
    for_all(20, [](Rng& rng, int size) {
      const PointCloud<float> target = sample(rng, yard(), 10 * size);
      const SE3d T_target_source = random_motion(rng, 3.0, 1.0);
      const PointCloud<float> source = seen_from(sample(rng, yard(), 8 * size, 0.2), T_target_source);
      const Overlap overlap = measure_overlap(source, KdTree<double>(target), T_target_source, 0.3);
      Index inliers = 0;
      double squared = 0;
      for (std::size_t i = 0; i < source.size(); ++i) {
        double nearest = std::numeric_limits<double>::infinity();
        for (std::size_t j = 0; j < target.size(); ++j)
          nearest = std::min(nearest, (T_target_source * position(source, i) - position(target, j)).squaredNorm());
        if (nearest > 0.3 * 0.3) continue;
        ++inliers;
        squared += nearest;
      }
      CHECK(overlap.inliers == inliers);
      CHECK(overlap.share_of_source == doctest::Approx(static_cast<double>(inliers) / (8 * size)));
      CHECK(overlap.share_of_target == doctest::Approx(static_cast<double>(inliers) / (10 * size)));
      if (inliers > 0) CHECK(overlap.rmse == doctest::Approx(std::sqrt(squared / inliers)));
    });
  }

  TEST_CASE("a cloud lies on itself; elsewhere, or without points, nothing does") {
    Rng rng(1);
    PointCloud<float> cloud = sample(rng, yard(), 500);
    const KdTree<float> target(cloud);
    cloud.positions.push_back(Eigen::Vector3f::Constant(std::numeric_limits<float>::quiet_NaN()));
    const Overlap here = measure_overlap(cloud, target, SE3d(), 0.1);
    CHECK(here.inliers == 500);
    CHECK(here.share_of_source == 1);
    CHECK(here.share_of_target == 1);
    CHECK(here.rmse == 0);
    for (const Overlap& overlap : {measure_overlap(cloud, target, SE3d(SO3d(), Eigen::Vector3d(500, 0, 0)), 0.1),
                                   measure_overlap(cloud, KdTree<float>(), SE3d(), 0.1),
                                   measure_overlap(PointCloud<float>{}, target, SE3d(), 0.1)}) {
      CHECK(overlap.inliers == 0);
      CHECK(overlap.share_of_source == 0);
      CHECK(overlap.share_of_target == 0);
      CHECK(overlap.rmse == 0);
    }
  }

  THREADS_TEST_CASE("registration/overlap",
                    "any number of threads gives the same bits; senseless arguments are refused") {
    Rng rng(2);
    const KdTree<float> target(sample(rng, yard(), 3000));
    const PointCloud<float> source = sample(rng, yard(), 3000, 0.1);
    const Overlap expected = measure_overlap(source, target, SE3d(), 0.5);
    for (const Index threads : {1, 2, 4}) {
      const Overlap overlap = measure_overlap(source, target, SE3d(), 0.5, ThreadPool(threads));
      CHECK(overlap.inliers == expected.inliers);
      CHECK(overlap.rmse == expected.rmse);
    }
    CHECK_THROWS_AS((void)measure_overlap(source, target, SE3d(), 0.0), std::invalid_argument);
    const SE3d nan(SO3d(), Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN()));
    CHECK_THROWS_AS((void)measure_overlap(source, target, nan, 0.5), std::invalid_argument);
  }
}

}  // namespace chainslam::test
