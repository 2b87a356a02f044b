#pragma once

#include <Eigen/Geometry>
#include <numbers>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/random.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/search/indexed_cloud.hpp"

namespace chainslam::test {

/// A rectangle in space: corner + [0, 1] u + [0, 1] v.
struct Patch {
  Eigen::Vector3d corner, u, v;
};

/// Floor, two walls that meet, a lower third wall and a box: no symmetry, all directions determined.
inline std::vector<Patch> yard() {
  return {{{-10, -6, 0}, {20, 0, 0}, {0, 12, 0}}, {{-10, -6, 0}, {20, 0, 0}, {0, 0, 5}},
          {{10, -6, 0}, {0, 12, 0}, {0, 0, 5}},   {{-10, 6, 0}, {8, 0, 0}, {0, 0, 2}},
          {{2, 1, 0}, {1.5, 1, 0}, {0, 0, 3}},    {{3.5, 2, 0}, {-1, 1.5, 0}, {0, 0, 3}}};
}

/// Floor, ceiling and two walls along x, without ends.
inline std::vector<Patch> corridor() {
  return {{{-20, -2, 0}, {40, 0, 0}, {0, 4, 0}},
          {{-20, -2, 3}, {40, 0, 0}, {0, 4, 0}},
          {{-20, -2, 0}, {40, 0, 0}, {0, 0, 3}},
          {{-20, 2, 0}, {40, 0, 0}, {0, 0, 3}}};
}

/// `count` points on the patches by area, with exact normals and noise across the surface.
inline PointCloud<float> sample(Rng& rng, const std::vector<Patch>& patches, Index count, double noise = 0.0) {
  std::vector<double> areas;
  double total = 0;
  for (const Patch& patch : patches) areas.push_back(total += patch.u.cross(patch.v).norm());
  PointCloud<float> cloud;
  for (Index i = 0; i < count; ++i) {
    const double at = rng.uniform(0, total);
    std::size_t which = 0;
    while (which + 1 < patches.size() && areas[which] < at) ++which;
    const Patch& patch = patches[which];
    const Eigen::Vector3d normal = patch.u.cross(patch.v).normalized();
    const Eigen::Vector3d p =
        patch.corner + rng.uniform() * patch.u + rng.uniform() * patch.v + noise * rng.normal() * normal;
    cloud.positions.push_back(p.cast<float>());
    cloud.normals.push_back(normal.cast<float>());
  }
  return cloud;
}

/// Points of twenty metres of the corridor, far from its ends, with a centimetre of noise.
inline PointCloud<float> middle_of_corridor(Rng& rng, Index count) {
  std::vector<Patch> inner = corridor();
  for (Patch& patch : inner) {
    patch.corner.x() = -10;
    patch.u.x() = 20;
  }
  return sample(rng, inner, count, 0.01);
}

/// The points seen from the source's frame: p_source = T_target_source^-1 p_target.
inline PointCloud<float> seen_from(const PointCloud<float>& cloud, const SE3d& T_target_source) {
  PointCloud<float> result;
  const SE3d T_source_target = T_target_source.inverse();
  for (const Eigen::Vector3f& p : cloud.positions)
    result.positions.push_back((T_source_target * p.cast<double>().eval()).cast<float>());
  return result;
}

/// A motion by up to `metres` and `radians` along each axis.
inline SE3d random_motion(Rng& rng, double metres, double radians) {
  Vector6d xi;
  for (int i = 0; i < 3; ++i) xi[i] = rng.uniform(-metres, metres);
  for (int i = 3; i < 6; ++i) xi[i] = rng.uniform(-radians, radians);
  return SE3d::exp(xi);
}

/// Some pose that nothing is symmetric under.
inline SE3d asymmetric_pose() {
  return SE3d(SO3d::exp(Eigen::Vector3d(0.02, -0.03, 0.9)), Eigen::Vector3d(3, -1.5, 0.7));
}

inline double translation_error(const SE3d& truth, const SE3d& estimate) {
  return (truth.inverse() * estimate).translation().norm();
}
/// Radians.
inline double rotation_error(const SE3d& truth, const SE3d& estimate) {
  return (truth.inverse() * estimate).rotation().log().norm();
}

}  // namespace chainslam::test
