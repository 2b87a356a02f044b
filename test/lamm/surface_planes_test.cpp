#include "surface_planes.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <vector>

#include "lamm/keypoint_places.hpp"
#include "support/property.hpp"

namespace chainslam {
namespace {

/// Points all over a rectangle that two edges span from a corner, `noise` metres off it.
void add_rectangle(const Eigen::Vector3d& corner, const Eigen::Vector3d& first, const Eigen::Vector3d& second,
                   double noise, Rng& rng, PointCloud<float>& cloud) {
  const Eigen::Vector3d normal = first.cross(second).normalized();
  const auto points = static_cast<int>(20 * first.norm() * second.norm());
  for (int i = 0; i < points; ++i)
    cloud.positions.push_back(
        (corner + rng.uniform() * first + rng.uniform() * second + rng.normal(0, noise) * normal).cast<float>());
}

}  // namespace

TEST_SUITE("lamm/surface_planes") {
  TEST_CASE("ground, walls and the largest of them are found, however they are moved") {
    test::for_all(20, [](Rng& rng, int /*size*/) {
      PointCloud<float> cloud;
      add_rectangle({-10, -10, 0}, {20, 0, 0}, {0, 20, 0}, 0.02, rng, cloud);
      add_rectangle({-10, 11, 0}, {20, 0, 0}, {0, 0, 6}, 0.02, rng, cloud);
      add_rectangle({-10, -10, 5}, {8, 0, 0}, {0, 8, 0}, 0.02, rng, cloud);  // a roof, parallel to the ground
      const SE3d T = test::random_motion(rng, 100);
      for (Eigen::Vector3f& p : cloud.positions) p = (T * p.cast<double>().eval()).cast<float>();
      const std::vector<SurfacePlane> planes = surface_planes(cloud);
      Index ground = 0, wall = 0;
      for (const SurfacePlane& plane : planes) {
        const Eigen::Vector3d p = T.inverse() * plane.center;
        const Eigen::Vector3d n = T.rotation().inverse() * plane.normal;
        if (std::abs(p.z()) < 0.1) ground += std::abs(n.z()) > 0.99;
        if (std::abs(p.y() - 11) < 0.1) wall += std::abs(n.y()) > 0.99;
      }
      CHECK(ground >= 60);  // 100 voxels, of which some hold a corner of two surfaces
      CHECK(wall >= 20);
      const std::optional<SurfacePlane> largest = largest_plane(planes);
      REQUIRE(largest);
      CHECK(std::abs((T.rotation().inverse() * largest->normal).z()) > 0.9999);
      CHECK(std::abs((T.inverse() * largest->center).z()) < 0.02);
    });
  }

  TEST_CASE("a piece needs more points than ten, and none off the plane") {
    Rng rng(1);
    const auto pieces = [&](int points, double noise) {
      PointCloud<float> cloud;
      for (int i = 0; i < points; ++i)
        cloud.positions.push_back(
            Eigen::Vector3d(rng.uniform(0, 2), rng.uniform(0, 2), 1 + rng.normal(0, noise)).cast<float>());
      return surface_planes(cloud).size();
    };
    CHECK(pieces(10, 0.01) == 0);
    CHECK(pieces(11, 0.01) == 1);
    CHECK(pieces(200, 0.07) == 1);  // a variance of 0.005 m^2
    CHECK(pieces(200, 0.14) == 0);  // of 0.02 m^2
  }

  TEST_CASE("a merged plane is that of all its points") {
    Rng rng(2);
    PointCloud<float> cloud;
    add_rectangle({-6, -6, 0.4}, {12, 0, 0.24}, {0, 12, -0.12}, 0.03, rng, cloud);
    const auto pieces = surface_planes(cloud);
    const auto whole = largest_plane(pieces);
    REQUIRE(whole);
    Index points = 0;
    for (const SurfacePlane& piece : pieces) points += piece.points;
    REQUIRE(whole->points == points);  // all are of one plane
    const PlaneFit direct = fit_plane(cloud);
    CHECK(std::abs(whole->normal.dot(direct.normal)) > 0.99999);
    CHECK(whole->distance(direct.centroid) < 0.005);
  }

  TEST_CASE("without points there are no pieces, and without pieces no plane") {
    CHECK(surface_planes({}).empty());
    CHECK(!largest_plane({}));
  }
}

}  // namespace chainslam
