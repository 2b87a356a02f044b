#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <unordered_map>
#include <vector>

#include "chainslam/core/types.hpp"
#include "simulator/plot.hpp"
#include "simulator/vehicle_motion.hpp"

namespace chainslam::simulator {

/// A place on the line that a vehicle has driven.
struct PathSample {
  Eigen::Vector3d ground;     ///< where the road is below the body, map frame, metres
  Eigen::Vector2d direction;  ///< of travel, unit length
  Eigen::Vector2d slope;      ///< of the road, (dz/dx, dz/dy)
  double along;               ///< from the start, metres; each further drive begins a kilometre after the one before
  double time;                ///< when it is passed, seconds

  [[nodiscard]] Eigen::Vector2d position() const { return ground.head<2>(); }
  [[nodiscard]] Eigen::Vector2d left() const { return {-direction.y(), direction.x()}; }
};

/// The lines on the ground that motions follow, half a metre from sample to sample, and what lies on them.
///
/// Every later question about a place ("does it stand in the way?") is asked of all passes at once, so that loops and
/// crossings need no care.
class DrivenPath {
 public:
  static constexpr double spacing = 0.5;  ///< metres

  /// @param body_height  of the body frame above the road, metres.
  DrivenPath(const VehicleMotion& motion, double body_height);
  /// Several drives over the same ground.
  DrivenPath(std::span<const VehicleMotion* const> motions, double body_height);

  [[nodiscard]] const std::vector<PathSample>& samples() const { return samples_; }
  [[nodiscard]] double length() const { return length_; }                    ///< of all drives, metres
  [[nodiscard]] double last_along() const { return samples_.back().along; }  ///< see `PathSample::along`
  /// Distance from a point to the nearest sample, or `reach` if there is none nearer, metres.
  [[nodiscard]] double distance(const Eigen::Vector2d& point, double reach) const;
  /// Whether no sample lies in the plot or nearer to it than `clearance`.
  [[nodiscard]] bool is_clear(const Plot& plot, double clearance) const;
  /// Whether an earlier pass has come by within `reach`: what lines the street stands there already.
  [[nodiscard]] bool was_passed_before(std::size_t sample, double reach) const;

 private:
  static constexpr double cell = 8.0;  ///< metres
  static std::uint64_t key(Index column, Index row);
  template <class Visit>
  void for_each_near(const Eigen::Vector2d& point, double reach, const Visit& visit) const;

  double length_ = 0.0;
  std::vector<PathSample> samples_;
  std::unordered_map<std::uint64_t, std::vector<Index>> cells_;
};

}  // namespace chainslam::simulator
