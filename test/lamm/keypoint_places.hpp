#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <numbers>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/random.hpp"
#include "chainslam/lie/se3.hpp"
#include "place_descriptor.hpp"

namespace chainslam::test {

/// A motion of any rotation, within `distance` metres along each axis.
inline SE3d random_motion(Rng& rng, double distance) {
  const Eigen::Vector3d turn(rng.normal(), rng.normal(), rng.normal());
  const Eigen::Vector3d axis = turn.normalized() * rng.uniform(0, std::numbers::pi);
  return SE3d(SO3d::exp(axis),
              {rng.uniform(-distance, distance), rng.uniform(-distance, distance), rng.uniform(-distance, distance)});
}

/// An order of `count` things.
inline std::vector<std::size_t> random_order(std::size_t count, Rng& rng) {
  std::vector<std::size_t> order(count);
  for (std::size_t i = 0; i < count; ++i) {
    const auto other = static_cast<std::size_t>(rng.uniform_index(to_index(i + 1)));
    order[i] = order[other];
    order[other] = i;
  }
  return order;
}

/// Keypoints all over a square, each with some of the 50 bins occupied.
inline std::vector<BinaryKeypoint> random_keypoints(Rng& rng, int count, double half_width = 40) {
  std::vector<BinaryKeypoint> keypoints;
  for (int i = 0; i < count; ++i) {
    const Eigen::Vector3d p(rng.uniform(-half_width, half_width), rng.uniform(-half_width, half_width), 0);
    const std::uint64_t occupancy = rng.bits() & rng.bits() & ((std::uint64_t{1} << 50) - 1);
    keypoints.push_back({.position = p.cast<float>(), .occupancy = occupancy});
  }
  return keypoints;
}

/// A place of such keypoints, and walls and ground about it as flat pieces.
inline PlaceDescriptor random_place(Rng& rng, int keypoints = 50) {
  PlaceDescriptor place;
  place.keypoints = random_keypoints(rng, keypoints);
  place.triangles = triangles_of(place.keypoints);
  PointCloud<float> planes;
  for (int i = 0; i < 60; ++i) {
    const bool ground = i % 3 == 0;
    const double bearing = rng.uniform(0, 2 * std::numbers::pi);
    const Eigen::Vector3d normal =
        ground ? Eigen::Vector3d::UnitZ() : Eigen::Vector3d(std::cos(bearing), std::sin(bearing), 0);
    planes.positions.push_back(
        Eigen::Vector3d(rng.uniform(-40, 40), rng.uniform(-40, 40), ground ? 0 : rng.uniform(0, 6)).cast<float>());
    planes.normals.push_back(normal.cast<float>());
  }
  place.planes = IndexedCloud<>(planes);
  return place;
}

/// What is seen of a place from elsewhere: some keypoints are missed, others are new, all are moved and off by
/// `noise` metres; bins come and go.
inline PlaceDescriptor seen_again(const PlaceDescriptor& place, const SE3d& T_view_place, double noise, Rng& rng) {
  PlaceDescriptor view;
  for (const BinaryKeypoint& keypoint : place.keypoints) {
    if (rng.uniform() < 0.15) continue;
    const Eigen::Vector3d off(rng.normal(0, noise), rng.normal(0, noise), 0);
    const std::uint64_t flicker = rng.bits() & rng.bits() & rng.bits() & rng.bits() & rng.bits();
    view.keypoints.push_back({.position = (T_view_place * (keypoint.position.cast<double>() + off)).cast<float>(),
                              .occupancy = keypoint.occupancy & ~flicker});
  }
  for (BinaryKeypoint& keypoint : random_keypoints(rng, 5)) {
    keypoint.position = (T_view_place * keypoint.position.cast<double>().eval()).cast<float>();
    view.keypoints.push_back(keypoint);
  }
  view.triangles = triangles_of(view.keypoints);
  PointCloud<float> planes = place.planes.cloud();
  for (Eigen::Vector3f& p : planes.positions) p = (T_view_place * p.cast<double>().eval()).cast<float>();
  for (Eigen::Vector3f& n : planes.normals) n = (T_view_place.rotation() * n.cast<double>().eval()).cast<float>();
  view.planes = IndexedCloud<>(planes);
  return view;
}

}  // namespace chainslam::test
