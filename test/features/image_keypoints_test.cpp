#include "chainslam/features/height_image.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <numbers>
#include <vector>

#include "chainslam/lie/se2.hpp"
#include "support/property.hpp"

namespace chainslam {
namespace {

using test::for_all;

/// Houses of four walls each, two heights of points every 0.2 m, seen from above after a motion.
std::vector<Eigen::Vector3d> village(Rng rng, int houses, const SE2d& motion) {
  std::vector<Eigen::Vector3d> cloud;
  for (int k = 0; k < houses; ++k) {
    const SE2d house(SO2<double>::from_angle(rng.uniform(-3, 3)), {rng.uniform(-40, 40), rng.uniform(-40, 40)});
    const double width = rng.uniform(4, 12), depth = rng.uniform(4, 12);
    for (double along = 0; along < 1; along += 0.2 / 12)
      for (const Eigen::Vector2d& wall : {Eigen::Vector2d(along * width, 0), Eigen::Vector2d(along * width, depth),
                                          Eigen::Vector2d(0, along * depth), Eigen::Vector2d(width, along * depth)}) {
        const Eigen::Vector2d p = motion * (house * wall);
        for (const double z : {0.0, 3.5}) cloud.emplace_back(p.x(), p.y(), z);
      }
  }
  return cloud;
}

}  // namespace

TEST_SUITE("features/image_keypoints") {
  TEST_CASE("a pole's keypoint is the pole, to a part of a pixel") {
    for_all(30, [](Rng& rng, int) {
      const Eigen::Vector2d pole(rng.uniform(-5, 5), rng.uniform(-5, 5));
      std::vector<Eigen::Vector3d> cloud;
      for (double x = -15; x < 15; x += 0.4)
        for (double y = -15; y < 15; y += 0.4) cloud.emplace_back(x, y, 0);
      for (double z = 0; z < 4; z += 0.2) cloud.emplace_back(pole.x(), pole.y(), z);
      const auto keypoints = image_keypoints(height_image(cloud));
      REQUIRE(!keypoints.empty());
      // The pole may fill any part of its pixel of 0.5 m.
      CHECK((keypoints.front().position.cast<double>() - pole).cwiseAbs().maxCoeff() < 0.3);
    });
  }

  TEST_CASE("most keypoints are found again in a turned image, with their angle turned as much and few bits changed") {
    for_all(10, [](Rng& rng, int) {
      const SE2d motion(SO2<double>::from_angle(rng.uniform(-3, 3)), {rng.uniform(-5, 5), rng.uniform(-5, 5)});
      const Rng world = rng.fork(1);
      const auto before = image_keypoints(height_image(village(world, 12, SE2d())));
      const auto after = image_keypoints(height_image(village(world, 12, motion)));
      REQUIRE(before.size() >= 30);
      int found = 0;
      for (const ImageKeypoint& a : before)
        for (const ImageKeypoint& b : after) {
          const double turned = static_cast<double>(b.angle - a.angle) - motion.rotation().angle();
          if ((motion * a.position.cast<double>().eval() - b.position.cast<double>()).norm() < 1.0 &&
              std::abs(std::remainder(turned, 2 * std::numbers::pi)) < 0.35 &&
              hamming_distance(a.descriptor, b.descriptor) <= 70) {
            ++found;
            break;
          }
        }
      CHECK(2 * found >= static_cast<int>(before.size()));
    });
  }

  TEST_CASE("keypoints come strongest first, apart from each other, and not more than asked for") {
    const HeightImage image = height_image(village(Rng(3), 12, SE2d()));
    const auto all = image_keypoints(image);
    const auto some = image_keypoints(image, {.max_count = 10});
    REQUIRE(all.size() > 10);
    REQUIRE(some.size() == 10);
    for (std::size_t i = 0; i < some.size(); ++i) CHECK(some[i].position == all[i].position);
    for (std::size_t i = 0; i < all.size(); ++i)
      for (std::size_t j = 0; j < i; ++j)  // 3 pixels, less what both may be moved between pixels
        CHECK((all[i].position - all[j].position).cwiseAbs().maxCoeff() > 0.5F * 2.9F);
  }

  TEST_CASE("an empty image and level ground have no keypoints, options that make no sense are refused") {
    CHECK(image_keypoints(HeightImage{}).empty());
    std::vector<Eigen::Vector3d> ground;
    for (double x = -15; x < 15; x += 0.2)
      for (double y = -15; y < 15; y += 0.2) ground.emplace_back(x, y, 0.01 * std::sin(40 * x * y));
    CHECK(image_keypoints(height_image(ground)).empty());
    CHECK_THROWS_AS(static_cast<void>(image_keypoints(HeightImage{}, {.smoothing = 0})), std::invalid_argument);
    CHECK_THROWS_AS(static_cast<void>(image_keypoints(HeightImage{}, {.separation = 0})), std::invalid_argument);
    CHECK_THROWS_AS(static_cast<void>(image_keypoints(HeightImage{}, {.radius = 1})), std::invalid_argument);
  }
}

}  // namespace chainslam
