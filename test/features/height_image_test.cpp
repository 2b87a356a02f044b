#include "chainslam/features/height_image.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "support/property.hpp"

namespace chainslam {
namespace {

using test::for_all;

float pixel_at(const HeightImage& image, double x, double y) {
  const Eigen::Vector2d at = (Eigen::Vector2d(x, y) - image.corner) / image.cell_size;
  const auto i = static_cast<Index>(std::floor(at.x())), j = static_cast<Index>(std::floor(at.y()));
  return image.contains(i, j) ? image.values[image.at(i, j)] : -1.0F;
}

}  // namespace

TEST_SUITE("features/height_image") {
  TEST_CASE("a pixel is the height that its points span, white from 4 m on") {
    const std::vector<Eigen::Vector3d> cloud{{0.1, 0.1, -1},   {0.2, 0.3, 1}, {5.1, 2.1, 0},
                                             {5.2, 2.2, 3.99}, {5.3, 2.2, 9}, {9.9, 9.9, 7}};
    const HeightImage image = height_image(cloud);
    CHECK(image.cell_size == 0.5);
    CHECK(pixel_at(image, 0.25, 0.25) == doctest::Approx(0.5));
    CHECK(pixel_at(image, 5.25, 2.25) == 1);
    CHECK(pixel_at(image, 9.75, 9.75) == 0);  // one point has no height
    CHECK(pixel_at(image, 3, 3) == 0);        // nothing there
    CHECK(image.width == 20);
    CHECK(image.height == 20);
    CHECK(image.position({0, 0}).x() == 0.25);
  }

  TEST_CASE("neither the level of the cloud nor the number of points or their order matters") {
    for_all(30, [](Rng& rng, int) {
      std::vector<Eigen::Vector3d> cloud;
      for (int i = 0; i < 300; ++i) cloud.emplace_back(rng.uniform(-20, 20), rng.uniform(-20, 20), rng.uniform(0, 5));
      const HeightImage image = height_image(cloud);
      std::vector<Eigen::Vector3d> other(cloud.rbegin(), cloud.rend());
      for (const Eigen::Vector3d& p : cloud) other.push_back(p);
      for (Eigen::Vector3d& p : other) p.z() += 64;  // a power of two: heights stay as they are but for rounding
      const HeightImage again = height_image(other);
      REQUIRE(again.values.size() == image.values.size());
      for (std::size_t i = 0; i < image.values.size(); ++i)
        CHECK(again.values[i] == doctest::Approx(image.values[i]).epsilon(1e-4));
    });
  }

  TEST_CASE("points out of range and those that are not finite are not drawn") {
    const double nan = std::numeric_limits<double>::quiet_NaN();
    const std::vector<Eigen::Vector3d> cloud{{99.9, 0, 0}, {100.1, 0, 0}, {0, -1e30, 0}, {nan, 0, 0}, {0, 0, nan}};
    const HeightImage image = height_image(cloud);
    CHECK(image.width == 1);
    CHECK(image.height == 1);
    CHECK(height_image(PointCloud<float>{}).values.empty());
    CHECK(height_image(std::vector<Eigen::Vector3d>{{nan, nan, nan}}).width == 0);
  }

  TEST_CASE("options that make no sense are refused") {
    const PointCloud<float> none;
    CHECK_THROWS_AS(static_cast<void>(height_image(none, {.cell_size = 0})), std::invalid_argument);
    CHECK_THROWS_AS(static_cast<void>(height_image(none, {.max_range = -1})), std::invalid_argument);
    CHECK_THROWS_AS(static_cast<void>(height_image(none, {.white = 0})), std::invalid_argument);
    CHECK_THROWS_AS(static_cast<void>(height_image(none, {.cell_size = 0.01})), std::invalid_argument);
  }
}

}  // namespace chainslam
