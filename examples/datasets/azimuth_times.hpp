#pragma once

#include <optional>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"

namespace chainslam::datasets {

/// Times of the points of one turn of a spinning LiDAR whose files state none: as far as a point's azimuth has turned
/// on from the first point's, as much of `period` has gone.
///
/// @param cloud   points in the order in which they were measured, z along the axis.
/// @param period  seconds of a turn.
/// @returns seconds from the first point, in [0, period]; nothing if the points do not turn steadily through about one
///   turn in their order, as where they are stored ring after ring.
[[nodiscard]] std::optional<std::vector<float>> times_by_azimuth(const PointCloud<float>& cloud, double period);

}  // namespace chainslam::datasets
