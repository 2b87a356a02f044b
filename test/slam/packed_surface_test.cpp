#include "chainslam/slam/detail/packed_surface.hpp"

#include <doctest/doctest.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <random>
#include <utility>

#include "chainslam/cloud/point_cloud.hpp"

using namespace chainslam;

namespace {

Eigen::Vector3f random_direction(std::mt19937& random) {
  std::normal_distribution<float> normal;
  return Eigen::Vector3f(normal(random), normal(random), normal(random)).normalized();
}

Eigen::Vector3f through_octahedron(const Eigen::Vector3f& n) { return detail::OctahedralNormal(n).vector(); }

}  // namespace

TEST_SUITE("slam/packed_surface") {
  TEST_CASE("a normal is off by 0.004 degrees at most, in any octant and on its borders") {
    constexpr unsigned seed = 7;
    CAPTURE(seed);
    std::mt19937 random(seed);
    float worst = 0, longest = 0;
    for (int i = 0; i < 200000; ++i) {
      Eigen::Vector3f n = random_direction(random);
      if (i % 4 == 0) n[i / 4 % 3] = 0;
      n.normalize();
      const Eigen::Vector3f back = through_octahedron(n);
      worst = std::max(worst, (back - n).norm());
      longest = std::max(longest, std::abs(back.norm() - 1));
    }
    CHECK(worst < 0.004F * 3.1416F / 180);
    CHECK(longest < 1e-6F);
    for (int axis = 0; axis < 3; ++axis)
      for (const float sign : {-1.0F, 1.0F}) {
        const Eigen::Vector3f n = sign * Eigen::Vector3f::Unit(axis);
        CHECK(through_octahedron(n) == n);
      }
    CHECK(through_octahedron(Eigen::Vector3f::Zero()) == Eigen::Vector3f::Zero());
  }

  TEST_CASE("positions are off by half a step at most, however far the points are") {
    constexpr unsigned seed = 8;
    CAPTURE(seed);
    std::mt19937 random(seed);
    std::uniform_real_distribution<float> range(0, 1);
    for (const auto& reach_and_step :
         {std::pair(160.0F, 0.005F), std::pair(320.0F, 0.01F), std::pair(1300.0F, 0.04F)}) {
      const float reach = reach_and_step.first, step = reach_and_step.second;
      CAPTURE(reach);
      PointCloud<float> cloud;
      for (int i = 0; i < 1000; ++i) {
        cloud.positions.push_back(reach * range(random) * random_direction(random));
        cloud.normals.push_back(i % 10 == 0 ? Eigen::Vector3f(0, 0, 0) : random_direction(random));
      }
      cloud.positions[0] = {reach, -reach, 0};
      const detail::PackedSurface packed(cloud);
      CHECK(packed.bytes() == 10 * cloud.size());
      const PointCloud<float> back = packed.unpacked();
      REQUIRE(back.size() == cloud.size());
      float farthest = 0;
      for (std::size_t i = 0; i < cloud.size(); ++i) {
        farthest = std::max(farthest, (back.positions[i] - cloud.positions[i]).cwiseAbs().maxCoeff());
        CHECK(back.normals[i] == through_octahedron(cloud.normals[i]));
      }
      CHECK(farthest <= 0.501F * step + 1e-6F * reach);
      CHECK(farthest > 0.4F * step);
      CHECK(detail::PackedSurface(back).unpacked().positions == back.positions);  // what was rounded stays
    }
  }
}
