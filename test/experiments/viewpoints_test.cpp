#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numbers>
#include <optional>
#include <utility>

#include "viewpoints/panorama.hpp"

namespace chainslam::experiments {
namespace {

PointCloud<float> one_point(double x, double y, double z) {
  PointCloud<float> cloud;
  cloud.positions.emplace_back(Eigen::Vector3d(x, y, z).cast<float>());
  return cloud;
}

PointCloud<float> with_intensity(PointCloud<float> cloud, float intensity) {
  cloud.intensities.assign(cloud.size(), intensity);
  return cloud;
}

std::size_t pixels_in(const Image& image) {
  std::size_t count = 0;
  for (const float value : image.values) count += std::isnan(value) ? 0 : 1;
  return count;
}

/// A room of 20 m by 12 m, its walls in steps of 0.1 m.
PointCloud<float> room() {
  PointCloud<float> cloud;
  const auto add = [&](double x, double y, double z) {
    cloud.positions.emplace_back(Eigen::Vector3d(x, y, z).cast<float>());
  };
  for (double z = -1.5; z < 4; z += 0.1) {
    for (double x = -10; x < 10; x += 0.1) add(x, 6, z), add(x, -6, z);
    for (double y = -6; y < 6; y += 0.1) add(10, y, z), add(-10, y, z);
  }
  return cloud;
}

}  // namespace

TEST_SUITE("experiments/viewpoints") {
  TEST_CASE("a point is drawn where its angles are, with its distance") {
    const PanoramaOptions options;
    Panorama image(options);
    // Elevation atan(-1/10) = -5.71 degrees: row floor(15 + 5.71) = 20; straight ahead is the border between columns
    // 179 and 180, a little to the right of it is 180.
    draw(image, options, one_point(10, -0.01, -1), SE3d(), 0.0);
    CHECK(pixels_in(image.ranges) == 1);
    CHECK(image.ranges.values[image.ranges.at(20, 180)] == doctest::Approx(std::sqrt(101.0) / 50).epsilon(1e-3));
    // To the left is a quarter of the turn before it: column 180 - 90, as the cloud is turned by 90 degrees.
    draw(image, options, one_point(20, -0.01, -2), SE3d(SO3d::exp({0, 0, std::numbers::pi / 2}), {0, 0, 0}), 0.0);
    CHECK(image.ranges.values[image.ranges.at(20, 90)] == doctest::Approx(std::sqrt(404.0) / 50).epsilon(1e-3));
    // Behind the first, and farther than the range: not seen. In front of it: seen.
    draw(image, options, one_point(30, -0.03, -3), SE3d(), 0.0);
    draw(image, options, one_point(60, -0.06, 0), SE3d(), 0.0);
    CHECK(pixels_in(image.ranges) == 2);
    CHECK(image.ranges.values[image.ranges.at(20, 180)] == doctest::Approx(std::sqrt(101.0) / 50).epsilon(1e-3));
    draw(image, options, one_point(5, -0.005, -0.5), SE3d(), 0.0);
    CHECK(image.ranges.values[image.ranges.at(20, 180)] == doctest::Approx(std::sqrt(25.25) / 50).epsilon(1e-3));
  }

  TEST_CASE("points are as large as they are drawn, and go around the seam") {
    const PanoramaOptions options;
    Panorama image(options);
    draw(image, options, one_point(-5.0, -0.01, 0), SE3d(), 0.3);
    // 0.3 m at 5 m: 3.4 degrees, 4 or 5 pixels each way.
    CHECK(pixels_in(image.ranges) >= 16);
    CHECK(pixels_in(image.ranges) <= 25);
    CHECK(!std::isnan(image.ranges.values[image.ranges.at(15, 0)]));
    CHECK(!std::isnan(image.ranges.values[image.ranges.at(15, 359)]));
  }

  TEST_CASE("the intensity of a pixel is that of the point that is seen there") {
    const PanoramaOptions options;
    Panorama image(options);
    const auto seen = [&] { return image.intensities.values[image.intensities.at(20, 180)]; };
    draw(image, options, with_intensity(one_point(10, -0.01, -1), 40), SE3d(), 0.0);
    CHECK(seen() == 40);
    CHECK(pixels_in(image.intensities) == 1);
    draw(image, options, with_intensity(one_point(30, -0.03, -3), 70), SE3d(), 0.0);  // behind it
    CHECK(seen() == 40);
    draw(image, options, with_intensity(one_point(5, -0.005, -0.5), 0), SE3d(), 0.0);
    CHECK(seen() == 0);
    draw(image, options, one_point(2, -0.002, -0.2), SE3d(), 0.0);  // without
    CHECK(std::isnan(seen()));
  }

  TEST_CASE("a surface is what two scans have, and what one has alone is seen only where there is no other") {
    PanoramaOptions options;
    options.columns = 4;
    options.rows = 1;
    const float nothing = std::numeric_limits<float>::quiet_NaN();
    Layers layers(options);
    // In parts of 50 m: half a metre is 0.01. A passer-by at 5 m that one scan has, before a wall at 20 m; a wall whose
    // two scans are 0.4 m apart, before one that three have; nothing but one scan; nothing.
    for (const auto& values : {std::array{0.1F, 0.3F, 0.7F, nothing}, std::array{0.4F, 0.308F, nothing, nothing},
                               std::array{0.402F, 0.5F, nothing, nothing}, std::array{nothing, 0.5F, nothing, nothing},
                               std::array{nothing, 0.5F, nothing, nothing}}) {
      Panorama one(options);
      std::ranges::copy(values, one.ranges.values.begin());
      // Intensities tell whose range is seen: a thousand times it.
      for (std::size_t i = 0; i < values.size(); ++i) one.intensities.values[i] = 1000 * values[i];
      layers.add(one);
    }
    const Panorama image = layers.nearest_surfaces();
    CHECK(image.ranges.values[0] == doctest::Approx(0.401));
    CHECK(image.ranges.values[1] == doctest::Approx(0.304));
    CHECK(image.ranges.values[2] == doctest::Approx(0.7));
    CHECK(std::isnan(image.ranges.values[3]));
    for (std::size_t i = 0; i < 3; ++i)
      CHECK(image.intensities.values[i] == doctest::Approx(1000 * image.ranges.values[i]));
    CHECK(std::isnan(image.intensities.values[3]));
  }

  TEST_CASE("errors are those of their definitions") {
    PanoramaOptions options;
    options.columns = 8;
    options.rows = 2;
    Image scan(options), rendered(options);
    for (std::size_t i = 0; i < 4; ++i) scan.values[i] = 0.5F, rendered.values[i] = 0.6F;
    scan.values[4] = 0.2F;      // the map has nothing there: 1, and 0 below
    rendered.values[5] = 0.1F;  // the scan has nothing there: not compared
    const ViewErrors errors = compare(scan, rendered, 1.0F);
    CHECK(errors.pixels == 5);
    CHECK(errors.uncovered == doctest::Approx(0.2));
    CHECK(errors.psnr == doctest::Approx(-10 * std::log10((4 * 0.01 + 0.64) / 5)).epsilon(1e-5));
    CHECK(errors.loss > 0.8 * (4 * 0.1 + 0.8) / 5);         // and something for a structure that is not alike
    CHECK(errors.loss < 0.8 * (4 * 0.1 + 0.8) / 5 + 0.41);  // 1 - SSIM is at most 2
    const ViewErrors same = compare(scan, scan, 1.0F);
    CHECK(same.psnr == 100);
    CHECK(compare(scan, rendered, 0.0F).psnr == doctest::Approx(-10 * std::log10((4 * 0.01 + 0.04) / 5)).epsilon(1e-5));
    CHECK(same.loss == doctest::Approx(0).epsilon(1e-9));
    CHECK(compare(Image(options), rendered, 1.0F).pixels == 0);
  }

  TEST_CASE("intensities are scaled by what 99 of 100 pixels of the scan do not exceed") {
    PanoramaOptions options;
    options.columns = 20;
    options.rows = 11;
    Image scan(options);
    for (std::size_t i = 0; i < 200; ++i) scan.values[i] = static_cast<float>(200 - i);  // 20 pixels have none
    CHECK(full_intensity(scan, options) == 198.0F);
    scan.values[0] = std::numeric_limits<float>::infinity();
    CHECK(full_intensity(scan, options) == 198.0F);  // of 199 then: rank 198
    const Image values = scaled(scan, 100.0F);
    CHECK(values.values[0] == 1);
    CHECK(values.values[50] == 1);
    CHECK(values.values[150] == 0.5F);
    CHECK(std::isnan(values.values[219]));
    CHECK(scaled(Image(options), 100.0F).values.size() == 220);
    CHECK_FALSE(full_intensity(Image(options), options));
    std::ranges::fill(scan.values, 0.0F);  // all dark: no scale
    CHECK_FALSE(full_intensity(scan, options));
  }

  TEST_CASE("similarity of two constant images is that of their means") {
    PanoramaOptions options;
    options.columns = 30;
    options.rows = 30;
    Image a(options), b(options);
    for (float& value : a.values) value = 0.5F;
    for (float& value : b.values) value = 0.25F;
    // (2 * 0.125 + 1e-4) / (0.25 + 0.0625 + 1e-4): the second factor is 1.
    const double ssim = (0.25 + 1e-4) / (0.3125 + 1e-4);
    CHECK(compare(a, b, 1.0F).loss == doctest::Approx(0.8 * 0.25 + 0.2 * (1 - ssim)).epsilon(1e-4));
  }

  TEST_CASE("the farther a pose is from the truth, the worse its view") {
    const PanoramaOptions options;
    const PointCloud<float> walls = room();
    Panorama scan(options);
    draw(scan, options, walls, SE3d(), 0.0);
    double before = 1e9;
    for (const double error : {0.0, 0.1, 0.4, 1.5}) {
      Panorama rendered(options);
      draw(rendered, options, walls, SE3d(SO3d::exp({0, 0, 0.1 * error}), {error, error, 0}), options.point_size);
      const ViewErrors errors = compare(scan.ranges, rendered.ranges, 1.0F);
      CAPTURE(error);
      CHECK(errors.psnr < before);
      before = errors.psnr;
    }
    CHECK(before < 35);
  }

  TEST_CASE("intensities show an error along a wall, which ranges do not") {
    const PanoramaOptions options;
    PointCloud<float> wall;  // 40 m long, with windows of 2 m, 4 m apart
    for (double x = -20; x < 20; x += 0.05)
      for (double z = -1; z < 2; z += 0.05) {
        wall.positions.emplace_back(Eigen::Vector3d(x, 6, z).cast<float>());
        wall.intensities.push_back(std::fmod(x + 100, 4) < 2 ? 20.0F : 80.0F);
      }
    Panorama scan(options);
    draw(scan, options, wall, SE3d(), 0.0);
    const std::optional<float> full = full_intensity(scan.intensities, options);
    REQUIRE(full == 80.0F);
    const auto errors_at = [&](double along) {
      Panorama rendered(options);
      draw(rendered, options, wall, SE3d(SO3d(), {along, 0, 0}), 0.1);
      return std::pair(compare(scan.ranges, rendered.ranges, 1.0F),
                       compare(scaled(scan.intensities, *full), scaled(rendered.intensities, *full), 0.0F));
    };
    const auto [ranges, intensities] = errors_at(0.0);
    const auto [moved_ranges, moved_intensities] = errors_at(1.0);
    CHECK(intensities.pixels == ranges.pixels);
    CHECK(moved_ranges.psnr > 20);
    CHECK(intensities.psnr > moved_intensities.psnr + 3);
    CHECK(intensities.loss < 0.5 * moved_intensities.loss);
    // Half of the wall is 20 for 80 or 80 for 20 then: 0.75 of the full value.
    CHECK(moved_intensities.psnr == doctest::Approx(-10 * std::log10(0.5 * 0.75 * 0.75)).epsilon(0.2));
  }
}

}  // namespace chainslam::experiments
