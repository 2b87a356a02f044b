#pragma once

#include <Eigen/Core>
#include <utility>

#include "chainslam/filter/concepts.hpp"
#include "chainslam/odometry/inertial_state.hpp"

namespace chainslam {

/// Densities of an inertial unit's noise; the defaults are wide of any unit on a vehicle that trembles.
struct ImuNoise {
  double gyro = 1e-3;             ///< rad/s per sqrt(Hz)
  double accel = 2e-2;            ///< m/s^2 per sqrt(Hz)
  double gyro_bias_walk = 5e-5;   ///< rad/s per sqrt(s)
  double accel_bias_walk = 2e-4;  ///< m/s^2 per sqrt(s)
};

enum class ImuIntegration {
  midpoint,  ///< specific force turned by the attitude half-way, second order; noise grows with time
  euler,     ///< FAST-LIO2, eq. 1 to 3 and 8: by the attitude at the start; variances are per sample, times dt^2
};

/// What drives an inertial process during a short time: mean readings, and how far they may be trusted.
struct ImuInput {
  Eigen::Vector3d gyro = Eigen::Vector3d::Zero();   ///< rad/s
  Eigen::Vector3d accel = Eigen::Vector3d::Zero();  ///< specific force, m/s^2
  double gyro_noise = 0;                            ///< density, added to the unit's own: clipped or made-up readings
  double accel_noise = 0;                           ///< the same
};

/// Strapdown inertial navigation: a `ProcessModel` of `InertialState`.
struct ImuProcess {
  using Input = ImuInput;

  ImuNoise noise{};
  ImuIntegration integration = ImuIntegration::midpoint;
  double gravity = 9.81;  ///< m/s^2
  double up_walk = 0;     ///< radians per sqrt(s), by which gravity's direction moves beside the bend: maps creep

  /// @param dt  seconds, short: rates and forces count as constant (10 ms suffice for anything that carries a LiDAR).
  [[nodiscard]] Transition<InertialState> predict(const InertialState& x, const ImuInput& input, double dt) const;

  /// Acceleration in odom, m/s^2, at a state.
  [[nodiscard]] Eigen::Vector3d acceleration(const InertialState& x, const ImuInput& input) const {
    return x.get<Inertial::rotation>() * Eigen::Vector3d(input.accel - x.get<Inertial::accel_bias>().value()) -
           gravity * x.get<Inertial::up>().direction();
  }

 private:
  /// Turns up as far as the map is bent over the way of `dt` seconds.
  static void lean(const InertialState& x, double dt, Transition<InertialState>& step);
};
static_assert(ProcessModel<ImuProcess, InertialState>);

/// up' = exp(w) up with w = dt bend up x velocity: the way's horizontal part, times the bend, is added to it.
inline void ImuProcess::lean(const InertialState& x, double dt, Transition<InertialState>& step) {
  using Part = Inertial::Part;
  constexpr int v = inertial_offset<Part::velocity>, bend = inertial_offset<Part::bend>;
  constexpr int up = inertial_offset<Part::up>, creep = inertial_offset<Part::creep>;
  const Eigen::Vector3d& before = x.get<Part::up>().direction();
  const auto basis = x.get<Part::up>().basis();
  const Eigen::Vector3d velocity = x.get<Part::velocity>().value();
  const double bent = dt * x.get<Part::bend>().value()[0];
  const Eigen::Vector3d across = before.cross(velocity);
  const SO3d turn = SO3d::exp(bent * across);
  const S2d after = turn * x.get<Part::up>();
  step.state.get<Part::up>() = after;
  step.state.get<Part::creep>() = R2d(x.get<Part::creep>().value() + (after.direction() - before).head<2>());

  // d up' / d (w, up, velocity)
  const Eigen::Matrix3d by_turn = -turn.matrix() * SO3d::hat(before) * SO3d::right_jacobian(bent * across);
  const Eigen::Matrix<double, 3, 2> by_up = (turn.matrix() - bent * by_turn * SO3d::hat(velocity)) * basis;
  const Eigen::Matrix3d by_velocity = bent * by_turn * SO3d::hat(before);
  const Eigen::Vector3d by_bend = dt * by_turn * across;
  const Eigen::Matrix<double, 2, 3> to_tangent = after.basis().transpose();
  step.F.block<2, 2>(up, up) = to_tangent * by_up;
  step.F.block<2, 3>(up, v) = to_tangent * by_velocity;
  step.F.block<2, 1>(up, bend) = to_tangent * by_bend;
  step.F.block<2, 2>(creep, up) = (by_up - basis).topRows<2>();
  step.F.block<2, 3>(creep, v) = by_velocity.topRows<2>();
  step.F.block<2, 1>(creep, bend) = by_bend.head<2>();
}

inline Transition<InertialState> ImuProcess::predict(const InertialState& x, const ImuInput& input, double dt) const {
  using Part = Inertial::Part;
  constexpr int p = inertial_offset<Part::position>, R = inertial_offset<Part::rotation>;
  constexpr int v = inertial_offset<Part::velocity>;
  constexpr int up = inertial_offset<Part::up>, creep = inertial_offset<Part::creep>;
  constexpr int bg = inertial_offset<Part::gyro_bias>, ba = inertial_offset<Part::accel_bias>;
  const bool midpoint = integration == ImuIntegration::midpoint;

  const Eigen::Vector3d turn = dt * (input.gyro - x.get<Part::gyro_bias>().value());
  const Eigen::Vector3d force = input.accel - x.get<Part::accel_bias>().value();
  const Eigen::Vector3d half_turn = (midpoint ? 0.5 : 0.0) * turn;
  const SO3d to_force = SO3d::exp(half_turn);
  const Eigen::Matrix3d R_force = (x.get<Part::rotation>() * to_force).matrix();
  const Eigen::Vector3d acceleration = R_force * force - gravity * x.get<Part::up>().direction();
  const Eigen::Vector3d velocity = x.get<Part::velocity>().value();

  Transition<InertialState> step{x, Transition<InertialState>::Matrix::Identity(),
                                 Transition<InertialState>::Matrix::Zero()};
  step.state.get<Part::rotation>() = x.get<Part::rotation>() * SO3d::exp(turn);
  step.state.get<Part::velocity>() = R3d(velocity + dt * acceleration);
  step.state.get<Part::position>() =
      R3d(x.get<Part::position>().value() + dt * velocity + 0.5 * dt * dt * acceleration);

  // d acceleration / d (rotation, gyro bias, accel bias, up)
  const Eigen::Matrix3d by_rotation = -x.get<Part::rotation>().matrix() * SO3d::hat(to_force * force);
  const Eigen::Matrix3d by_gyro_bias =
      (midpoint ? 0.5 * dt : 0.0) * (R_force * SO3d::hat(force) * SO3d::right_jacobian(half_turn));
  const Eigen::Matrix<double, 3, 2> by_up = -gravity * x.get<Part::up>().basis();
  for (const auto& [row, factor] : {std::pair{p, 0.5 * dt * dt}, std::pair{v, dt}}) {
    step.F.block<3, 3>(row, R) = factor * by_rotation;
    step.F.block<3, 3>(row, bg) = factor * by_gyro_bias;
    step.F.block<3, 3>(row, ba) = -factor * R_force;
    step.F.block<3, 2>(row, up) = factor * by_up;
  }
  step.F.block<3, 3>(p, v) = dt * Eigen::Matrix3d::Identity();
  step.F.block<3, 3>(R, R) = SO3d::exp(turn).matrix().transpose();
  step.F.block<3, 3>(R, bg) = -dt * SO3d::right_jacobian(turn);

  lean(x, dt, step);

  // Noise of a reading acts as an error of its bias does. The mean of white noise over dt has variance density^2 / dt.
  const double per_time = midpoint ? 1.0 / dt : 1.0;
  const auto squared = [](double value) { return value * value; };
  const auto by_gyro = step.F.middleCols<3>(bg).topRows<9>();
  const auto by_accel = step.F.middleCols<3>(ba).topRows<9>();
  step.Q.topLeftCorner<9, 9>() =
      per_time * (squared(noise.gyro) + squared(input.gyro_noise)) * (by_gyro * by_gyro.transpose()) +
      per_time * (squared(noise.accel) + squared(input.accel_noise)) * (by_accel * by_accel.transpose());
  step.Q.diagonal().segment<3>(bg).setConstant(dt * dt * per_time * squared(noise.gyro_bias_walk));
  step.Q.diagonal().segment<3>(ba).setConstant(dt * dt * per_time * squared(noise.accel_bias_walk));
  const Eigen::Matrix2d by_walk = step.state.get<Part::up>().basis().topRows<2>();
  step.Q.block<2, 2>(up, up) = dt * squared(up_walk) * Eigen::Matrix2d::Identity();
  step.Q.block<2, 2>(creep, up) = dt * squared(up_walk) * by_walk;
  step.Q.block<2, 2>(up, creep) = step.Q.block<2, 2>(creep, up).transpose();
  step.Q.block<2, 2>(creep, creep) = dt * squared(up_walk) * by_walk * by_walk.transpose();
  return step;
}

}  // namespace chainslam
