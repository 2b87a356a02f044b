#include "chainslam/cloud/quantize.hpp"

#include <doctest/doctest.h>

#include <limits>
#include <set>

#include "chainslam/core/random.hpp"
#include "support/property.hpp"

namespace chainslam::test {
namespace {

PointCloud<float> random_points(Rng& rng, int count, double metres) {
  PointCloud<float> cloud;
  for (int i = 0; i < count; ++i) {
    Eigen::Vector3f p;
    for (Eigen::Index axis = 0; axis < 3; ++axis) p[axis] = static_cast<float>(rng.normal(0, metres));
    cloud.positions.push_back(p);
  }
  return cloud;
}

double distance_to(const PointCloud<float>& cloud, const Eigen::Vector3f& p) {
  float nearest = std::numeric_limits<float>::infinity();
  for (const Eigen::Vector3f& q : cloud.positions) nearest = std::min(nearest, (p - q).cwiseAbs().maxCoeff());
  return static_cast<double>(nearest);
}

}  // namespace

TEST_SUITE("cloud/quantize") {
  TEST_CASE("every point has one within half a step, on the grid, and none twice") {
    for_all(50, [](Rng& rng, int size) {
      const double step = size % 2 == 0 ? 0.01 : 0.025;
      const PointCloud<float> cloud = random_points(rng, 5 * size, 2);
      const PointCloud<float> result = quantized(cloud, step);
      CHECK(result.size() <= cloud.size());
      for (const Eigen::Vector3f& p : cloud.positions) CHECK(distance_to(result, p) <= 0.5 * step + 1e-6);
      for (const Eigen::Vector3f& p : result.positions) CHECK(distance_to(cloud, p) <= 0.5 * step + 1e-6);
      const std::optional<PositionGrid> grid = grid_of(result, step);
      REQUIRE(grid);
      CHECK(grid->step == step);
      std::set<std::array<float, 3>> seen;
      for (const Eigen::Vector3f& p : result.positions) CHECK(seen.insert({p[0], p[1], p[2]}).second);
    });
  }

  TEST_CASE("the order of the points does not matter, and quantizing again changes nothing") {
    for_all(50, [](Rng& rng, int size) {
      PointCloud<float> cloud = random_points(rng, 5 * size, size > 50 ? 300 : 0.05);
      const PointCloud<float> once = quantized(cloud);
      CHECK(quantized(once).positions == once.positions);
      std::reverse(cloud.positions.begin(), cloud.positions.end());
      cloud.positions.push_back(cloud.positions.front());
      CHECK(quantized(cloud).positions == once.positions);
    });
  }

  TEST_CASE("points beyond 16 bits make the whole cloud coarser, up to sixteen times") {
    const auto step_for = [](float farthest) {
      const PointCloud<float> cloud = quantized(std::vector<Eigen::Vector3f>{{1, 2, 3}, {0, -farthest, 0}});
      REQUIRE(cloud.size() == 2);
      return grid_of(cloud)->step;
    };
    CHECK(step_for(327.67F) == 0.01);
    CHECK(step_for(327.68F) == 0.02);
    CHECK(step_for(1000) == 0.04);
    CHECK(step_for(5242) == 0.16);
    CHECK(quantized(std::vector<Eigen::Vector3f>{{1, 2, 3}, {0, 0, 5300}}).size() == 1);
    CHECK(grid_of(quantized(std::vector<Eigen::Vector3f>{{1, 2, 3}, {0, 0, 5300}}))->step == 0.01);
  }

  TEST_CASE("empty clouds, points that are not finite, negative zero, steps that are none") {
    constexpr float nan = std::numeric_limits<float>::quiet_NaN(), inf = std::numeric_limits<float>::infinity();
    CHECK(quantized(PointCloud<float>{}).empty());
    const PointCloud<float> cloud =
        quantized(std::vector<Eigen::Vector3f>{{nan, 0, 0}, {0, inf, 0}, {-0.001F, 0, 1}, {0, 0, 1}, {0, 0, -inf}});
    REQUIRE(cloud.size() == 1);
    CHECK(!std::signbit(cloud.positions[0][0]));
    CHECK(!grid_of({.positions = {{-0.0F, 0, 0}}}));
    CHECK(!grid_of({.positions = {{nan, 0, 0}}}));
    CHECK(!grid_of({.positions = {{0.5F, 0.123456F, 0}}}));
    for (const double step : {0.0, -1.0, static_cast<double>(nan), static_cast<double>(inf)})
      CHECK_THROWS_AS(static_cast<void>(quantized(cloud, step)), std::invalid_argument);
  }

  TEST_CASE("other columns are left out") {
    PointCloud<float> cloud;
    cloud.positions = {{1, 2, 3}};
    cloud.intensities = {5};
    cloud.normals = {{0, 0, 1}};
    const PointCloud<float> result = quantized(cloud);
    CHECK(result.size() == 1);
    CHECK(result.intensities.empty());
    CHECK(result.normals.empty());
  }

  TEST_CASE("intensities are the means of the points rounded to a place, which are those without them") {
    for_all(50, [](Rng& rng, int size) {
      const double metres = size % 3 == 0 ? 300 : 0.05;  // a coarser grid; many points to a place
      PointCloud<float> cloud = random_points(rng, 5 * size, metres);
      cloud.positions[0] = {std::numeric_limits<float>::quiet_NaN(), 0, 0};
      for (std::size_t i = 0; i < cloud.size(); ++i)
        cloud.intensities.push_back(static_cast<float>(rng.uniform_index(256)));
      const PointCloud<float> plain = quantized(cloud), result = quantized_with_intensities(cloud);
      CHECK(result.positions == plain.positions);
      REQUIRE(result.intensities.size() == result.size());
      std::vector<double> sums(result.size()), counts(result.size());
      for (std::size_t i = 1; i < cloud.size(); ++i) {
        std::size_t nearest = 0;
        for (std::size_t k = 0; k < result.size(); ++k)
          if ((result.positions[k] - cloud.positions[i]).norm() <
              (result.positions[nearest] - cloud.positions[i]).norm())
            nearest = k;
        sums[nearest] += static_cast<double>(cloud.intensities[i]);
        counts[nearest] += 1;
      }
      for (std::size_t k = 0; k < result.size(); ++k)
        CHECK(result.intensities[k] == static_cast<float>(sums[k] / counts[k]));
    });
    PointCloud<float> bare;
    bare.positions = {{1, 2, 3}};
    CHECK(quantized_with_intensities(bare).positions == bare.positions);
    CHECK(quantized_with_intensities(bare).intensities.empty());
    CHECK(quantized_with_intensities(PointCloud<float>{}).empty());
    CHECK(quantized_with_intensities(std::vector<Eigen::Vector3f>{{1, 2, 3}}).size() == 1);
  }

  TEST_CASE("Morton's codes lead back to their numbers and order neighbours together") {
    for_all(1000, [](Rng& rng, int) {
      std::array<std::int16_t, 3> numbers{};
      for (std::int16_t& number : numbers) number = static_cast<std::int16_t>(rng.bits());
      CHECK(chainslam::detail::morton_numbers(chainslam::detail::morton_code(numbers)) == numbers);
    });
    CHECK(chainslam::detail::morton_code({0, 0, 1}) == chainslam::detail::morton_code({0, 0, 0}) + 1);
    CHECK(chainslam::detail::morton_code({-32768, -32768, -32768}) == 0);
    CHECK(chainslam::detail::morton_code({32767, 32767, 32767}) == 0xffff'ffff'ffff);
  }
}

}  // namespace chainslam::test
