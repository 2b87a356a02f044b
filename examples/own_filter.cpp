// An iterated error-state Kalman filter with a state, a process and a measurement of one's own: a vehicle in the plane
// whose positions are measured, and whose heading, speed and turn rate follow from them.
// Usage: example_own_filter [POSITIONS.tum], of which time, x and y are used; without a file, a generated drive.
#include <chainslam/io/trajectory_file.hpp>
#include <chainslam/lie/product.hpp>
#include <chainslam/lie/rn.hpp>
#include <chainslam/lie/se2.hpp>
#include <chainslam/odometry/ieskf.hpp>
#include <cstdio>

#include "generated/arc_fixes.hpp"

using namespace chainslam;

using State = Product<SE2d, Rn<double, 2>>;  // T_map_body in the plane; forward speed in m/s, turn rate in rad/s

struct Unicycle {
  struct Input {};  // nothing drives it: speed and turn rate are a random walk
  double speed_noise = 0.1, turn_noise = 0.02;

  Transition<State> predict(const State& x, const Input&, double dt) const {
    const SE2d::Tangent step(x.get<1>().value()[0] * dt, 0, x.get<1>().value()[1] * dt);
    State::Jacobian F = State::Jacobian::Identity(), Q = State::Jacobian::Zero();
    F.topLeftCorner<3, 3>() = SE2d::exp(step).inverse().adjoint();
    F.topRightCorner<3, 2>() = dt * SE2d::right_jacobian(step)(Eigen::all, {0, 2});
    Q.diagonal().tail<2>() << speed_noise * speed_noise * dt, turn_noise * turn_noise * dt;
    return {State(x.get<0>().retract(step), x.get<1>()), F, Q};
  }
};

struct Position {
  Eigen::Vector2d measured;  ///< in the map, metres
  double sigma = 0.1;

  Linearization<State> linearize(const State& x, bool /*renew*/) const {
    Eigen::Matrix<double, 2, State::dof> H = Eigen::Matrix<double, 2, State::dof>::Zero();
    H.leftCols<2>() = x.get<0>().rotation().matrix() / sigma;  // of a right perturbation
    const Eigen::Vector2d r = (x.get<0>().translation() - measured) / sigma;
    return {H.transpose() * H, -H.transpose() * r, r.squaredNorm(), 2};
  }
};

int main(int count, char** arguments) try {
  const Trajectory fixes = count == 2 ? read_tum(arguments[1]) : generated::arc_fixes(5.0, 0.25, 0.1);
  State::Jacobian start = State::Jacobian::Identity();
  start.diagonal() << 100, 100, 1, 25, 1;  // variances: little is known of where it is and how fast
  Ieskf<State, Unicycle> filter(State(), start);
  double nis = 0;
  for (std::size_t i = 0; i < fixes.size(); ++i) {
    if (i > 0) filter.predict({}, to_seconds(fixes.times[i] - fixes.times[i - 1]));
    Position position{.measured = fixes.poses[i].translation().head<2>()};
    nis += filter.update(position).nis / static_cast<double>(2 * fixes.size());
  }
  const Eigen::Vector2d rates = filter.state().get<1>().value();
  const Eigen::Vector2d sigmas = filter.covariance().diagonal().tail<2>().cwiseSqrt();
  std::printf("fixes      %zu\nspeed      %.3f +- %.3f m/s\nturn rate  %.3f +- %.3f rad/s\nnis        %.3f\n",
              fixes.size(), rates[0], sigmas[0], rates[1], sigmas[1], nis);
} catch (const std::exception& failure) {
  return std::fprintf(stderr, "%s\n", failure.what()), 2;
}
