#pragma once

#include <Eigen/Core>
#include <vector>

#include "chainslam/core/types.hpp"
#include "simulator/shapes.hpp"

namespace chainslam::simulator {

/// The ground: heights on a regular grid, two triangles to a cell (split along the cell's diagonal from its lower left
/// to its upper right corner).
struct HeightField {
  Eigen::Vector2f origin = Eigen::Vector2f::Zero();  ///< x, y of sample (0, 0), metres
  float spacing = 1.0F;                              ///< metres between samples
  Index columns = 0;                                 ///< samples along x
  Index rows = 0;                                    ///< samples along y
  std::vector<float> heights;                        ///< z of sample (column, row) at [row * columns + column], metres
  std::vector<Material> materials;  ///< of the cell whose lower left sample it is; as long as `heights`

  [[nodiscard]] std::size_t at(Index column, Index row) const {
    return static_cast<std::size_t>(row) * static_cast<std::size_t>(columns) + static_cast<std::size_t>(column);
  }
  /// z of the sample nearest to a position within the field, metres.
  [[nodiscard]] double height_at(const Eigen::Vector2d& position) const {
    const Eigen::Vector2d local = (position - origin.cast<double>()) / static_cast<double>(spacing);
    return static_cast<double>(heights[at(static_cast<Index>(local.x() + 0.5), static_cast<Index>(local.y() + 0.5))]);
  }
};

/// All that a ray can meet. World frame: x, y horizontal, z up, metres.
struct World {
  HeightField ground;
  std::vector<Box> boxes;
  std::vector<Cylinder> cylinders;
  std::vector<Ellipsoid> ellipsoids;
};

}  // namespace chainslam::simulator
