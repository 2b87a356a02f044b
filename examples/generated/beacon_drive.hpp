#pragma once

#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/io/g2o.hpp"

namespace generated {

/// The true pose after so many steps of 1 m along an arc, from the origin.
inline chainslam::SE2d arc_pose(int steps) { return chainslam::SE2d::exp({1.0 * steps, 0, 0.02 * steps}); }

/// 60 steps along the arc, each measured with noise of 2 cm and 0.01 rad.
inline chainslam::G2oRecords<chainslam::SE2d> beacon_drive() {
  using chainslam::SE2d;
  chainslam::Rng rng(1);
  chainslam::G2oRecords<SE2d> records;
  records.vertices.push_back({0, SE2d()});
  for (int i = 0; i < 60; ++i) {
    const SE2d measured = arc_pose(1) * SE2d::exp({rng.normal(0, 0.02), rng.normal(0, 0.02), rng.normal(0, 0.01)});
    records.vertices.push_back({i + 1, records.vertices.back().pose * measured});
    records.edges.push_back({i, i + 1, measured, Eigen::Vector3d(2500, 2500, 10000).asDiagonal()});
  }
  return records;
}

struct BeaconDistance {
  std::int64_t id;  ///< of the vertex
  double distance;  ///< metres
};

/// The distances to a beacon at (20, 15) m from every other vertex, measured to 5 cm.
inline std::vector<BeaconDistance> beacon_distances() {
  chainslam::Rng rng(2);
  std::vector<BeaconDistance> distances;
  for (int i = 2; i <= 60; i += 2)
    distances.push_back({i, rng.normal((Eigen::Vector2d(20, 15) - arc_pose(i).translation()).norm(), 0.05)});
  return distances;
}

}  // namespace generated
