#include "simulator/ray_caster.hpp"

#include <doctest/doctest.h>

#include <numbers>

#include "brute_force.hpp"
#include "chainslam/core/random.hpp"
#include "simulator/place.hpp"
#include "simulator/preset.hpp"
#include "support/property.hpp"

namespace chainslam::simulator {
namespace {

using chainslam::test::for_all;
using test::BruteForce;

Eigen::Vector3d random_point(Rng& rng, double half, double top) {
  Eigen::Vector3d p;
  p.x() = rng.uniform(-half, half);
  p.y() = rng.uniform(-half, half);
  p.z() = rng.uniform(0.0, top);
  return p;
}

Eigen::Vector3f random_direction(Rng& rng) {
  Eigen::Vector3f d;
  for (int axis = 0; axis < 3; ++axis) d[axis] = static_cast<float>(rng.normal());
  return d.normalized();
}

/// Shapes of all kinds over rough ground, in an area of 30 m x 30 m; some reach beyond the ground.
World random_world(Rng& rng, int size) {
  World world;
  HeightField& ground = world.ground;
  ground.origin = {-11.0F, -12.0F};
  ground.spacing = 0.7F;
  ground.columns = 34;
  ground.rows = 31;
  for (Index i = 0; i < ground.columns * ground.rows; ++i)
    ground.heights.push_back(static_cast<float>(rng.uniform(-0.5, 0.5)));
  ground.materials.assign(ground.heights.size(), Material::lawn);
  for (int i = 0; i < size; ++i) {
    const Eigen::Matrix3d turn = SO3d::exp(3.0 * random_direction(rng).cast<double>()).matrix();
    const Place place{random_point(rng, 15.0, 5.0), turn};
    const Eigen::Vector3d half = 0.2 * Eigen::Vector3d::Ones() + random_point(rng, 0.1, 2.0);
    add_box(world, place, -half, half, Material::wall);
    add_cylinder(world, place, Eigen::Vector3d::Zero(), rng.uniform(0.05, 1.0), half.z(), Material::metal);
    add_ellipsoid(world, place, 2.0 * half, half, Material::foliage);
  }
  return world;
}

/// The cast must lie between the answers for a world 1 mm fatter and one 1 mm thinner, and nearly always be the exact
/// one.
void check_rays(const RayCaster& caster, const std::vector<Ray>& rays) {
  constexpr double grow = 1e-3;
  constexpr double rounding = 1e-3;  // single precision at 100 m and steep grazing
  const BruteForce fat(caster.world(), grow), exact(caster.world(), 0.0), thin(caster.world(), -grow);
  int equal = 0;
  for (const Ray& ray : rays) {
    const auto hit = caster.cast(ray);
    const double distance = hit ? static_cast<double>(hit->distance) : std::numeric_limits<double>::infinity();
    CHECK(distance >= fat.cast(ray) - rounding);
    CHECK(distance <= thin.cast(ray) + rounding);
    const double expected = exact.cast(ray);
    equal += distance == expected || std::abs(distance - expected) < rounding ? 1 : 0;
    if (hit) CHECK(hit->normal.dot(ray.direction) < 1e-3F);
    if (hit) CHECK(hit->normal.norm() == doctest::Approx(1.0).epsilon(1e-4));
  }
  CHECK(equal >= 0.995 * static_cast<double>(rays.size()));
}

}  // namespace

TEST_SUITE("simulator/ray_caster") {
  TEST_CASE("casts agree with testing every shape and every triangle") {
    for_all(30, [](Rng& rng, int size) {
      const RayCaster caster(random_world(rng, size), static_cast<float>(rng.uniform(0.5, 6.0)));
      std::vector<Ray> rays;
      for (int i = 0; i < 40; ++i)
        rays.push_back({.origin = random_point(rng, 25.0, 6.0).cast<float>(),
                        .direction = random_direction(rng),
                        .max_distance = static_cast<float>(rng.uniform(1.0, 60.0))});
      check_rays(caster, rays);
    });
  }

  TEST_CASE("casts along the axes and along grid lines agree too") {
    Rng rng(7);
    const RayCaster caster(random_world(rng, 12), 2.1F);
    std::vector<Ray> rays;
    for (int axis = 0; axis < 3; ++axis)
      for (const float sign : {-1.0F, 1.0F})
        for (int i = 0; i < 60; ++i) {
          Eigen::Vector3f origin = random_point(rng, 14.0, 6.0).cast<float>();
          origin.x() = -11.0F + 0.7F * static_cast<float>(i % 20);  // on a line of the ground's grid
          rays.push_back({.origin = origin + Eigen::Vector3f(0.01F, 0.01F, 0.01F) * static_cast<float>(i % 2),
                          .direction = sign * Eigen::Vector3f::Unit(axis),
                          .max_distance = 50.0F});
        }
    check_rays(caster, rays);
  }

  TEST_CASE("casts into a whole town agree with brute force") {
    const Town town = make_town(preset("town-small")->town, Rng(3));
    const RayCaster caster(town.world);
    Rng rng(4);
    const Eigen::Vector2d at = town.streets.position({1, 1});
    const Eigen::Vector3d eye(at.x(), at.y(), town.terrain.height(at) + 1.9);
    std::vector<Ray> rays;
    for (int i = 0; i < (chainslam::test::quick() ? 20 : 150); ++i) {
      const double azimuth = rng.uniform(0.0, 2.0 * std::numbers::pi);
      const double elevation = rng.uniform(-0.55, 0.25);
      const Eigen::Vector3d d(std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth),
                              std::sin(elevation));
      rays.push_back({eye.cast<float>(), d.cast<float>(), 100.0F});
    }
    check_rays(caster, rays);
  }

  TEST_CASE("a ray sees the material and the side that it meets") {
    World world;
    add_box(world, {}, {4.0, -1.0, -1.0}, {5.0, 1.0, 1.0}, Material::glass);
    add_cylinder(world, {}, {8.0, 0.0, -1.0}, 0.5, 2.0, Material::bark);
    const RayCaster caster(world);
    const auto hit = caster.cast({{0.0F, 0.0F, 0.0F}, {1.0F, 0.0F, 0.0F}, 10.0F});
    REQUIRE(hit);
    CHECK(hit->distance == 4.0F);
    CHECK(hit->material == Material::glass);
    CHECK(hit->normal == Eigen::Vector3f(-1.0F, 0.0F, 0.0F));
    CHECK_FALSE(caster.cast({{0.0F, 0.0F, 0.0F}, {1.0F, 0.0F, 0.0F}, 3.9F}));
    CHECK_FALSE(caster.cast({{0.0F, 0.0F, 0.0F}, {-1.0F, 0.0F, 0.0F}, 10.0F}));
    const auto from_inside = caster.cast({{4.5F, 0.0F, 0.0F}, {1.0F, 0.0F, 0.0F}, 10.0F});
    REQUIRE(from_inside);
    CHECK(from_inside->material == Material::bark);
    CHECK(from_inside->distance == doctest::Approx(3.0));
  }

  TEST_CASE("a world without anything, or with ground of the wrong size, is refused") {
    CHECK_THROWS_AS(RayCaster(World{}), std::invalid_argument);
    World world;
    world.ground.columns = 3;
    world.ground.rows = 3;
    world.ground.heights.assign(8, 0.0F);
    world.ground.materials.assign(9, Material::road);
    CHECK_THROWS_AS(RayCaster(std::move(world)), std::invalid_argument);
  }
}

}  // namespace chainslam::simulator
