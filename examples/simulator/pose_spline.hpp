#pragma once

#include "chainslam/trajectory/trajectory.hpp"
#include "simulator/spline.hpp"
#include "simulator/vehicle_motion.hpp"

namespace chainslam::simulator {

/// How smooth a spline is at the cost of how closely it follows recorded poses.
///
/// Each is the deviation of a recorded pose from its neighbours over the spectral density of the third derivative, as
/// of a smoother that takes it for white noise. The defaults make the spline of KITTI's truth agree best with the IMU
/// that was recorded with it.
struct PoseSplineOptions {
  double position_smoothing = 2e-3;    ///< 0.02 m over 10 m/s^3 per sqrt(Hz), s^2.5
  double rotation_smoothing = 2.5e-4;  ///< 5e-4 rad over 2 rad/s^3 per sqrt(Hz), s^2.5
  double longest_knot = 0.1;           ///< between control points, seconds; less where poses are nearer to each other
};

/// A smooth motion along recorded poses: four times continuously differentiable, so that the rates and specific forces
/// of an IMU follow from it.
///
/// Position and quaternion are one uniform B-spline of degree 5 in seven dimensions, fitted by least squares with a
/// penalty on third differences (P-splines, Eilers and Marx 1996); the rotation is the normalized quaternion. Body
/// rates follow in closed form: 2 Im(conj(q) dq/dt) / |q|^2.
class PoseSpline final : public VehicleMotion {
 public:
  /// @param trajectory  T_map_body, at least 6 poses over a second, times increasing; time 0 is the first pose's.
  /// @throws std::invalid_argument if it is not so.
  explicit PoseSpline(const Trajectory& trajectory, const PoseSplineOptions& options = {});

  [[nodiscard]] double duration() const override { return duration_; }
  [[nodiscard]] Motion motion(double time) const override;

 private:
  double duration_;  ///< from the first pose to the last, seconds
  Spline<7> spline_;
};

}  // namespace chainslam::simulator
