#pragma once

#include "chainslam/core/random.hpp"
#include "simulator/lane_path.hpp"
#include "simulator/spline.hpp"
#include "simulator/town.hpp"
#include "simulator/vehicle_motion.hpp"

namespace chainslam::simulator {

/// How the vehicle drives.
struct DriveOptions {
  double lane = 1.7;                  ///< right of the street's middle, metres
  double cruise = 9.5;                ///< on straight streets, m/s; each street has its own, up to 15 % off
  double lateral_acceleration = 2.9;  ///< in corners, m/s^2
  double acceleration = 2.0;          ///< m/s^2
  double braking = 2.5;               ///< m/s^2
  double rest_at_start = 2.0;         ///< seconds
  double rest_at_end = 1.0;           ///< seconds
  double stop_at = 0.45;              ///< where it stops on the way, as a part of the path; negative: nowhere
  double stop_duration = 2.0;         ///< seconds
  double between_stops = 0.0;         ///< more stops, mean distance, 0.5 to 1.5 times that, metres; 0: none
  double body_height = 1.65;          ///< body above the road, metres
  double vibration_height = 1.5e-3;   ///< standard deviation at 8 m/s, metres
  double vibration_angle = 1.2e-3;    ///< in pitch and roll at 8 m/s, radians
  double vibration_speed = 8.0;       ///< where it has that size, m/s; it grows with the speed up to 1.5 times
  double dive = 0.006;                ///< pitch for braking, radians per m/s^2; a segway leans the other way
  double lean = 0.008;                ///< roll in corners, radians per m/s^2
  double sway_angle = 0.0;            ///< of a segway that keeps its balance, amplitude of pitch while driving, radians
  double sway_period = 1.3;           ///< seconds
  CornerRadii corners{};
};

/// A smooth drive along a route (see `follow_lane`) through the town: four times continuously differentiable, at rest
/// at both ends.
///
/// The speed obeys the corners; position and attitude follow the terrain, pitch with the pedals and roll in corners,
/// and tremble with the speed.
class Drive final : public VehicleMotion {
 public:
  Drive(const DriveOptions& options, const Route& route, const Town& town, const Rng& rng);

  [[nodiscard]] double duration() const override { return spline_.duration(); }
  [[nodiscard]] double length() const { return path_.length(); }  ///< along the path, metres
  [[nodiscard]] Motion motion(double time) const override;

  /// The line that it follows, and how far along it is at a time, metres.
  [[nodiscard]] const LanePath& path() const { return path_; }
  [[nodiscard]] double driven(double time) const;

 private:
  LanePath path_;
  std::vector<double> driven_;  ///< along the path every `step` of the plan, metres
  Spline<6> spline_;            ///< x, y, z, roll, pitch, yaw
};

}  // namespace chainslam::simulator
