#pragma once

#include <Eigen/Core>
#include <vector>

#include "chainslam/core/random.hpp"
#include "simulator/driven_path.hpp"
#include "simulator/terrain.hpp"
#include "simulator/world.hpp"

namespace chainslam::simulator {

/// How the ground around a driven path is laid.
struct GroundOptions {
  double border = 90.0;      ///< ground beyond the path's outermost places, metres
  double spacing = 0.5;      ///< between samples of the ground; doubled for areas that would have too many, metres
  double half_road = 3.8;    ///< from the path to the kerb, metres
  double pavement = 1.8;     ///< from the kerb to the building line, metres
  double kerb = 0.12;        ///< height of the pavement above the road, metres
  double steepness = 0.025;  ///< of each wave of the relief away from the road, see `Terrain`
};

/// The ground around a driven path: the road where it was driven, with its heights, slopes and cross slopes, one
/// surface for all passes; hills where it was not.
///
/// Near the path heights are the mean of the planes through the path's samples, weighted by 1 / distance^4, so that
/// passes at different heights meet halfway; far away they are filled in from coarser and coarser means (push and pull,
/// Gortler et al. 1996).
class PathTerrain {
 public:
  /// @throws std::invalid_argument if the area is too large: more than 64 million samples at twice the spacing.
  PathTerrain(const DrivenPath& path, const GroundOptions& options, const Rng& rng);

  /// Height of the road's surface, or of what goes on from it, metres.
  [[nodiscard]] double height(const Eigen::Vector2d& position) const;
  /// ... and of the ground itself: with kerbs and the relief beside the road, without its roughness.
  [[nodiscard]] double surface(const Eigen::Vector2d& position) const;
  /// To the nearest place of the path, at most 60, metres.
  [[nodiscard]] double distance(const Eigen::Vector2d& position) const;
  [[nodiscard]] HeightField lay_ground(Rng rng) const;

  [[nodiscard]] const GroundOptions& options() const { return options_; }
  [[nodiscard]] const Eigen::Vector2d& origin() const { return origin_; }
  [[nodiscard]] Eigen::Vector2d size() const { return Eigen::Vector2d(columns_ - 1, rows_ - 1); }

 private:
  void lay_road(const DrivenPath& path, std::vector<float>& weights);
  [[nodiscard]] double interpolate(const std::vector<float>& values, const Eigen::Vector2d& position) const;

  GroundOptions options_;
  Terrain relief_;
  Eigen::Vector2d origin_;
  Index columns_ = 0;  ///< of a grid with a metre's spacing
  Index rows_ = 0;
  std::vector<float> heights_;
  std::vector<float> distances_;
};

}  // namespace chainslam::simulator
