#pragma once

#include <string>

#include "chainslam/cloud/point_cloud.hpp"

namespace chainslam::datasets {

/// Where a scan's ground lies, if z is up and the sensor is mounted upright.
enum class GroundSide { below, above, unclear };

struct GroundCheck {
  GroundSide side = GroundSide::unclear;
  double height = 0;  ///< of the densest level slab over the sensor, metres; negative below
  double share = 0;   ///< of the points looked at that lie in it
};

/// Looks for the densest level slab of 0.5 m among the points 3 to 30 m away. A slab that holds a tenth of them, and
/// twice what the best slab on the sensor's other side holds, is the ground: a drive's road and floor outweigh ceilings
/// and trees. Slabs within 0.3 m of the sensor's height say nothing.
[[nodiscard]] GroundCheck find_ground(const PointCloud<float>& cloud);

}  // namespace chainslam::datasets
