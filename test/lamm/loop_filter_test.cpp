#include "loop_filter.hpp"

#include <doctest/doctest.h>

#include <vector>

#include "support/property.hpp"

namespace chainslam::lamm {

TEST_SUITE("lamm/loop_filter") {
  TEST_CASE("most loops between two sessions agree, and those far from them do not") {
    test::for_all(30, [](Rng& rng, int size) {
      const Eigen::Vector3d start(rng.uniform(-500, 500), rng.uniform(-500, 500), 0);
      std::vector<Eigen::Vector3d> points;
      const int good = 8 + size / 3, bad = 2;
      for (int i = 0; i < good; ++i)
        points.push_back(start + Eigen::Vector3d(rng.normal(0, 0.4), rng.normal(0, 0.4), 0));
      for (int i = 0; i < bad; ++i) points.push_back(start + Eigen::Vector3d(100 + 50 * i, -80, 0));
      const Agreement agreed = agreement(points, {});
      CHECK((agreed.center - start).norm() < 1);
      int kept = 0;
      for (int i = 0; i < good; ++i) kept += agreed.holds(points[static_cast<std::size_t>(i)]);
      CHECK(kept >= good / 2);
      for (int i = good; i < good + bad; ++i) CHECK(!agreed.holds(points[static_cast<std::size_t>(i)]));
    });
  }

  TEST_CASE("few loops are kept near their mean; as released only one that is alone is") {
    const std::vector<Eigen::Vector3d> near{{10, 0, 0}, {11, 1, 0}, {10, -1, 0}}, apart{{0, 0, 0}, {100, 0, 0}};
    const auto kept = [](const std::vector<Eigen::Vector3d>& points, const LoopFilterOptions& options) {
      const Agreement agreed = agreement(points, options);
      int count = 0;
      for (const Eigen::Vector3d& p : points) count += agreed.holds(p);
      return count;
    };
    const LoopFilterOptions released{.few_radius = 0};
    CHECK(kept(near, {}) == 3);
    CHECK(kept(apart, {}) == 0);
    CHECK(kept({{7, 8, 9}}, {}) == 1);
    CHECK(kept(near, released) == 0);
    CHECK(kept({{7, 8, 9}}, released) == 1);
    CHECK(agreement({}, {}).radius == 0);
  }

  TEST_CASE("a seed gives the same agreement again") {
    Rng rng(5);
    std::vector<Eigen::Vector3d> points;
    for (int i = 0; i < 40; ++i) points.emplace_back(rng.normal(0, 20), rng.normal(0, 20), 0);
    const LoopFilterOptions options{.max_draws = 200};
    CHECK(agreement(points, options).center == agreement(points, options).center);
    CHECK(agreement(points, options).center != agreement(points, {.max_draws = 200, .seed = 2}).center);
  }

  TEST_CASE("within a session a loop closes as long a way as odometry went, to 1.5 m") {
    const SE3d here, there(SO3d::exp({0, 0, 1}), {30, 40, 0});
    const auto agrees = [&](double length) {
      return agrees_with_odometry(SE3d(SO3d(), {0, length, 0}), here, there, {});
    };
    CHECK(agrees(50));
    CHECK(agrees(51.4));
    CHECK(agrees(48.6));
    CHECK(!agrees(51.6));
    CHECK(!agrees(48.4));
  }
}

}  // namespace chainslam::lamm
