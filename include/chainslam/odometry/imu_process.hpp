#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cstddef>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/product.hpp"
#include "chainslam/lie/rn.hpp"
#include "chainslam/lie/s2.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/lie/so3.hpp"
#include "chainslam/odometry/ieskf.hpp"
#include "chainslam/sensor/packet.hpp"

namespace chainslam {

/// A pose of the LiDAR as registration of its scans found it.
struct LidarPose {
  Timestamp time;                 ///< of the pose
  SE3d T_odom_lidar;              ///< in the odometry's frame
  double rotation_deviation = 0;  ///< rad about each axis, added to what the residuals say
  double position_deviation = 0;  ///< m along each axis; infinite if only the rotation is known
  double time_deviation = 0;      ///< s, of `time`; 0: exact
};

/// What LiDAR-inertial odometry estimates, 26 degrees of freedom (FAST-LIO2, eq. 3, with gravity's length known, and
/// how the map is out of level): `state.get<Inertial::velocity>()`.
struct Inertial {
  /// Positions of the parts of the state.
  enum Part : std::size_t {
    position,        ///< of the body in odom, metres
    rotation,        ///< R_odom_body
    velocity,        ///< of the body in odom, m/s
    gyro_bias,       ///< rad/s
    accel_bias,      ///< m/s^2
    up,              ///< against gravity, in odom
    tilt,            ///< by how much `up` has moved since the start, along x and y
    bend,            ///< 1/m: `up` leans with the way by so much, as over a map bent like a bowl
    lidar_position,  ///< of the LiDAR in the body frame, metres
    lidar_rotation,  ///< R_body_lidar
  };
};
using InertialState = Product<R3d, SO3d, R3d, R3d, R3d, S2d, R2d, R1d, R3d, SO3d>;
static_assert(InertialState::dof == 26);

/// Where the tangent of a part starts.
template <Inertial::Part Part>
inline constexpr int inertial_offset = InertialState::offset<Part>();

[[nodiscard]] inline SE3d T_odom_body(const InertialState& x) {
  return SE3d(x.get<Inertial::rotation>(), x.get<Inertial::position>().value());
}
[[nodiscard]] inline SE3d T_body_lidar(const InertialState& x) {
  return SE3d(x.get<Inertial::lidar_rotation>(), x.get<Inertial::lidar_position>().value());
}

/// d T / d (position, rotation), with T's tangent as everywhere, [translation in its own axes; rotation].
[[nodiscard]] inline Matrix6d pose_tangent(const SO3d& R) {
  Matrix6d tangent = identity<Matrix6d>();
  set_block(tangent, 0, 0, R.inverse().matrix());
  return tangent;
}

/// d (T_odom_body * T_body_lidar) / d x, 6 x 26.
[[nodiscard]] inline Eigen::Matrix<double, 6, InertialState::dof> lidar_pose_jacobian(const InertialState& x) {
  auto jacobian = zeros<Eigen::Matrix<double, 6, InertialState::dof>>();
  const Matrix6d to_lidar = T_body_lidar(x).inverse().adjoint();
  set_block(jacobian, 0, 0, product(to_lidar, pose_tangent(x.get<Inertial::rotation>())));
  set_block(jacobian, 0, InertialState::dof - 6, pose_tangent(x.get<Inertial::lidar_rotation>()));
  return jacobian;
}

/// Variances of T_odom_body * T_body_lidar from the covariance of the state; tangent [translation; rotation].
[[nodiscard]] inline Vector6d lidar_pose_variances(const InertialState& x, const InertialState::Jacobian& covariance) {
  const Eigen::Matrix<double, 6, InertialState::dof> by_state = lidar_pose_jacobian(x);
  const Eigen::Matrix<double, 6, InertialState::dof> weighted = product(by_state, covariance);
  Vector6d variances = zeros<Vector6d>();
  for (int j = 0; j < InertialState::dof; ++j)
    for (int i = 0; i < 6; ++i) variances[i] += weighted(i, j) * by_state(i, j);
  return variances;
}

/// Covariance of T_odom_body from that of the state; tangent [translation; rotation].
[[nodiscard]] inline Matrix6d pose_covariance(const InertialState& x, const InertialState::Jacobian& covariance) {
  const Matrix6d tangent = pose_tangent(x.get<Inertial::rotation>());
  return product_transposed(product(tangent, block_of<6, 6>(covariance, 0, 0)), tangent);
}

/// (m/s)^2, variance of the velocity, of all axes together.
[[nodiscard]] inline double velocity_variance(const InertialState::Jacobian& covariance) {
  constexpr int v = inertial_offset<Inertial::velocity>;
  return covariance(v, v) + covariance(v + 1, v + 1) + covariance(v + 2, v + 2);
}

/// Whether scans have observed the velocity.
[[nodiscard]] inline bool knows_velocity(const InertialState::Jacobian& covariance) {
  constexpr double known = 2;  // m/s
  return velocity_variance(covariance) < known * known;
}

/// Makes variances those of `deviation` at least, ...
inline void raise_to(InertialState::Jacobian& covariance, int begin, int end, double deviation) {
  for (int i = begin; i < end; ++i) covariance(i, i) = std::max(covariance(i, i), deviation * deviation);
}
/// ... those of a part.
template <Inertial::Part Part>
inline void raise_to(InertialState::Jacobian& covariance, double deviation) {
  constexpr int begin = inertial_offset<Part>;
  raise_to(covariance, begin, begin + InertialState::Part<Part>::dof, deviation);
}

/// Makes variances those of `deviation`, correlated with nothing, ...
inline void separate(InertialState::Jacobian& covariance, int begin, int end, double deviation) {
  for (int i = begin; i < end; ++i) {
    for (int j = 0; j < InertialState::dof; ++j) covariance(i, j) = covariance(j, i) = 0;
    covariance(i, i) = deviation * deviation;
  }
}
/// ... those of a part.
template <Inertial::Part Part>
inline void separate(InertialState::Jacobian& covariance, double deviation) {
  constexpr int begin = inertial_offset<Part>;
  separate(covariance, begin, begin + InertialState::Part<Part>::dof, deviation);
}

/// Densities of an IMU's noise; the defaults are wide of any unit on a vehicle that trembles.
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

/// What drives an inertial process during a short time: mean measurements, and how far they may be trusted.
struct ImuInput {
  Eigen::Vector3d gyro = Eigen::Vector3d::Zero();   ///< rad/s
  Eigen::Vector3d accel = Eigen::Vector3d::Zero();  ///< specific force, m/s^2
  double gyro_noise = 0;       ///< density, added to the unit's own: clipped or made-up measurements
  double accel_noise = 0;      ///< the same
  bool rate_measured = true;   ///< false: `gyro` is a guess of the rate, without information on the bias
  bool force_measured = true;  ///< false: constant velocity, without information on attitude, gravity and bias

  /// rad/s, body frame.
  [[nodiscard]] Eigen::Vector3d rate(const InertialState& x) const {
    if (!rate_measured) return gyro;
    return difference_of(gyro, x.get<Inertial::gyro_bias>().value());
  }
};

/// Strapdown inertial navigation: a `ProcessModel` of `InertialState`.
struct ImuProcess {
  using Input = ImuInput;  ///< what drives it

  ImuNoise noise{};                                       ///< spectral densities
  ImuIntegration integration = ImuIntegration::midpoint;  ///< how measurements are integrated
  double gravity = 9.81;                                  ///< m/s^2
  double up_walk = 0;  ///< radians per sqrt(s), by which gravity's direction moves beside the bend: maps tilt slowly

  /// @param dt  seconds, short: rates and forces count as constant (10 ms suffice for anything that carries a LiDAR).
  [[nodiscard]] Transition<InertialState> predict(const InertialState& x, const ImuInput& input, double dt) const;

 private:
  /// Turns up as far as the map is bent over the way of `dt` seconds.
  static void lean(const InertialState& x, double dt, Transition<InertialState>& step);
};
static_assert(ProcessModel<ImuProcess, InertialState>);

/// up' = exp(w) up with w = dt bend up x velocity: the way's horizontal part, times the bend, is added to it.
inline void ImuProcess::lean(const InertialState& x, double dt, Transition<InertialState>& step) {
  using Part = Inertial::Part;
  constexpr int v = inertial_offset<Part::velocity>, bend = inertial_offset<Part::bend>;
  constexpr int up = inertial_offset<Part::up>, tilt = inertial_offset<Part::tilt>;
  const Eigen::Vector3d& before = x.get<Part::up>().direction();
  const Eigen::Matrix<double, 3, 2> basis = x.get<Part::up>().basis();
  const Eigen::Vector3d velocity = x.get<Part::velocity>().value();
  const double bent = dt * x.get<Part::bend>().value()[0];
  const Eigen::Vector3d across = before.cross(velocity);
  const Eigen::Vector3d w = scaled(bent, across);
  const SO3d turn = SO3d::exp(w);
  const S2d after = turn * x.get<Part::up>();
  const Eigen::Vector3d change = difference_of(after.direction(), before);
  step.state.get<Part::up>() = after;
  step.state.get<Part::tilt>() = R2d(sum_of(x.get<Part::tilt>().value(), block_of<2, 1>(change, 0, 0)));

  // d up' / d (w, up, velocity)
  const Eigen::Matrix3d R = turn.matrix();
  const Eigen::Matrix3d by_turn = negative(product(product(R, SO3d::hat(before)), SO3d::right_jacobian(w)));
  const Eigen::Matrix3d by_way = scaled(bent, by_turn);
  const Eigen::Matrix3d by_direction = difference_of(R, product(by_way, SO3d::hat(velocity)));
  const Eigen::Matrix<double, 3, 2> by_up = product(by_direction, basis);
  const Eigen::Matrix3d by_velocity = product(by_way, SO3d::hat(before));
  const Eigen::Vector3d by_bend = scaled(dt, product(by_turn, across));
  const Eigen::Matrix<double, 2, 3> to_tangent = transposed(after.basis());
  set_block(step.F, up, up, product(to_tangent, by_up));
  set_block(step.F, up, v, product(to_tangent, by_velocity));
  set_block(step.F, up, bend, product(to_tangent, by_bend));
  set_block(step.F, tilt, up, block_of<2, 2>(difference_of(by_up, basis), 0, 0));
  set_block(step.F, tilt, v, block_of<2, 3>(by_velocity, 0, 0));
  set_block(step.F, tilt, bend, block_of<2, 1>(by_bend, 0, 0));
}

inline Transition<InertialState> ImuProcess::predict(const InertialState& x, const ImuInput& input, double dt) const {
  using Part = Inertial::Part;
  constexpr int p = inertial_offset<Part::position>, R = inertial_offset<Part::rotation>;
  constexpr int v = inertial_offset<Part::velocity>;
  constexpr int up = inertial_offset<Part::up>, tilt = inertial_offset<Part::tilt>;
  constexpr int bg = inertial_offset<Part::gyro_bias>, ba = inertial_offset<Part::accel_bias>;
  const bool midpoint = integration == ImuIntegration::midpoint;

  const Eigen::Vector3d turn = scaled(dt, input.rate(x));
  const Eigen::Vector3d force = difference_of(input.accel, x.get<Part::accel_bias>().value());
  const Eigen::Vector3d half_turn = scaled(midpoint ? 0.5 : 0.0, turn);
  const SO3d to_force = SO3d::exp(half_turn), turned = SO3d::exp(turn);
  const SO3d& R_odom_body = x.get<Part::rotation>();
  const Eigen::Matrix3d R_force = (R_odom_body * to_force).matrix();
  const Eigen::Vector3d weight = scaled(gravity, x.get<Part::up>().direction());
  Eigen::Vector3d acceleration = difference_of(product(R_force, force), weight);
  if (!input.force_measured) acceleration = zeros<Eigen::Vector3d>();
  const Eigen::Vector3d velocity = x.get<Part::velocity>().value();
  const Eigen::Vector3d gained = scaled(dt, acceleration);
  const Eigen::Vector3d mean_velocity = sum_of(velocity, scaled(0.5, gained));

  using Matrix = Transition<InertialState>::Matrix;
  Transition<InertialState> step{x, identity<Matrix>(), zeros<Matrix>()};
  step.state.get<Part::rotation>() = R_odom_body * turned;
  step.state.get<Part::velocity>() = R3d(sum_of(velocity, gained));
  step.state.get<Part::position>() = R3d(sum_of(x.get<Part::position>().value(), scaled(dt, mean_velocity)));

  // d acceleration / d (rotation, up), and d (position, rotation, velocity) / d (rate, force)
  const Eigen::Matrix3d by_rotation = negative(product(R_odom_body.matrix(), SO3d::hat(to_force * force)));
  const Eigen::Matrix3d by_half_turn = product(product(R_force, SO3d::hat(force)), SO3d::right_jacobian(half_turn));
  const Eigen::Matrix3d by_gyro_bias = scaled(midpoint ? 0.5 * dt : 0.0, by_half_turn);
  const Eigen::Matrix<double, 3, 2> by_up = scaled(-gravity, x.get<Part::up>().basis());
  auto by_gyro = zeros<Eigen::Matrix<double, 9, 3>>(), by_accel = by_gyro;
  const auto set_rows = [&](int row, double factor) {
    set_block(by_accel, row, 0, scaled(-factor, R_force));
    if (!input.force_measured) return;
    set_block(by_gyro, row, 0, scaled(factor, by_gyro_bias));
    set_block(step.F, row, R, scaled(factor, by_rotation));
    set_block(step.F, row, up, scaled(factor, by_up));
  };
  set_rows(p, 0.5 * dt * dt);
  set_rows(v, dt);
  set_block(by_gyro, R, 0, scaled(-dt, SO3d::right_jacobian(turn)));
  if (input.rate_measured) set_block(step.F, 0, bg, by_gyro);
  if (input.force_measured) set_block(step.F, 0, ba, by_accel);
  for (int i = 0; i < 3; ++i) step.F(p + i, v + i) = dt;
  set_block(step.F, R, R, turned.inverse().matrix());

  lean(x, dt, step);

  // Noise of a reading acts as an error of its bias does. The mean of white noise over dt has variance density^2 / dt.
  const double per_time = midpoint ? 1.0 / dt : 1.0;
  const auto squared = [](double value) { return value * value; };
  const double gyro_variance = per_time * (squared(noise.gyro) + squared(input.gyro_noise));
  const double accel_variance = per_time * (squared(noise.accel) + squared(input.accel_noise));
  const auto rows = [](const Eigen::Matrix<double, 9, 3>& A, int i, int j) {  // (A A^T)(i, j)
    return A(i, 0) * A(j, 0) + A(i, 1) * A(j, 1) + A(i, 2) * A(j, 2);
  };
  for (int j = 0; j < 9; ++j)
    for (int i = 0; i < 9; ++i)
      step.Q(i, j) = gyro_variance * rows(by_gyro, i, j) + accel_variance * rows(by_accel, i, j);
  for (int i = 0; i < 3; ++i) {
    step.Q(bg + i, bg + i) = dt * dt * per_time * squared(noise.gyro_bias_walk);
    step.Q(ba + i, ba + i) = dt * dt * per_time * squared(noise.accel_bias_walk);
  }
  const double walk = dt * squared(up_walk);
  const Eigen::Matrix2d by_walk = block_of<2, 2>(step.state.get<Part::up>().basis(), 0, 0);
  const Eigen::Matrix2d with_up = scaled(walk, by_walk);
  for (int i = 0; i < 2; ++i) step.Q(up + i, up + i) = walk;
  set_block(step.Q, tilt, up, with_up);
  set_block(step.Q, up, tilt, transposed(with_up));
  set_block(step.Q, tilt, tilt, product_transposed(with_up, by_walk));
  return step;
}

/// What an IMU says of its attitude and bias before the first scan.
struct ImuStart {
  bool at_rest = false;                                 ///< the measurements were quiet enough to be a standstill
  Eigen::Vector3d gyro_bias = Eigen::Vector3d::Zero();  ///< rad/s; zero unless at rest
  Eigen::Vector3d up_body = Eigen::Vector3d::UnitZ();   ///< direction against gravity, in the body frame
  Index samples = 0;                                    ///< IMU samples that it was estimated from
};

/// Detects standstill and estimates gravity's direction and the gyroscope's bias from it.
///
/// Gravity is taken as a direction only, so accelerometers in g and in m/s^2 serve alike. In motion the mean specific
/// force still shows the vertical, to some degrees; the bias is then left at zero and `at_rest` is false.
struct ImuInitializer {
  Index min_samples = 5;              ///< fewer: no attitude, `samples` stays what it was and `up_body` is +z
  double max_gyro_deviation = 0.03;   ///< rad/s, root mean square about the mean
  double max_gyro_mean = 0.15;        ///< rad/s; a steady turn is no standstill
  double max_accel_deviation = 0.03;  ///< relative to the mean specific force

  /// @param samples  any range of `ImuSample`, in time order, all finite. Those with a stuck axis do not count.
  template <class Samples>
  [[nodiscard]] ImuStart estimate(const Samples& samples) const {
    ImuStart start;
    const auto usable = [](const ImuSample& sample) { return sample.rate_measured && sample.force_measured; };
    start.samples = to_index(std::count_if(samples.begin(), samples.end(), usable));
    if (start.samples < min_samples) return start;
    const double n = static_cast<double>(start.samples);
    Eigen::Vector3d gyro = Eigen::Vector3d::Zero();
    Eigen::Vector3d accel = Eigen::Vector3d::Zero();
    for (const ImuSample& sample : samples) {
      if (!usable(sample)) continue;
      gyro = sum_of(gyro, divided(sample.gyro, n));
      accel = sum_of(accel, divided(sample.accel, n));
    }
    double gyro_variance = 0;
    double accel_variance = 0;
    for (const ImuSample& sample : samples) {
      if (!usable(sample)) continue;
      gyro_variance += difference_of(sample.gyro, gyro).squaredNorm() / n;
      accel_variance += difference_of(sample.accel, accel).squaredNorm() / n;
    }
    const double force = accel.norm();
    if (!(force > 0)) return start;
    start.up_body = divided(accel, force);
    start.at_rest = gyro_variance <= max_gyro_deviation * max_gyro_deviation && gyro.norm() <= max_gyro_mean &&
                    accel_variance <= max_accel_deviation * max_accel_deviation * force * force;
    if (start.at_rest) start.gyro_bias = gyro;
    return start;
  }
};

/// The attitude without yaw in which `up_body` points up: the shortest rotation R_odom_body with R_odom_body * up = +z.
[[nodiscard]] inline SO3d gravity_aligned(const Eigen::Vector3d& up_body) {
  return SO3d::between(up_body, Eigen::Vector3d::UnitZ());
}

}  // namespace chainslam
