// A Kalman filter of models of one's own: a body that moves at constant velocity, and measured positions.
#include <chainslam/lie/product.hpp>
#include <chainslam/lie/rn.hpp>
#include <chainslam/odometry/ieskf.hpp>

using State = chainslam::Product<chainslam::R3d, chainslam::R3d>;

struct ConstantVelocity {
  using Input = double;  // density of the acceleration, m/s^2 per sqrt(Hz)

  chainslam::Transition<State> predict(const State& x, const Input& density, double dt) const {
    using Matrix = chainslam::Transition<State>::Matrix;
    chainslam::Transition<State> step{x, Matrix::Identity(), Matrix::Zero()};
    step.state.get<0>() = chainslam::R3d(x.get<0>().value() + dt * x.get<1>().value());
    for (int i = 0; i < 3; ++i) {
      step.F(i, 3 + i) = dt;
      step.Q(3 + i, 3 + i) = density * density * dt;
    }
    return step;
  }
};

struct MeasuredPosition {
  Eigen::Vector3d position;
  double variance;

  chainslam::Linearization<State> linearize(const State& x, bool) {
    chainslam::Linearization<State> z;
    const Eigen::Vector3d residual = position - x.get<0>().value();
    for (int i = 0; i < 3; ++i) {
      z.information(i, i) = 1 / variance;
      z.gradient[i] = residual[i] / variance;
    }
    z.squared_error = residual.squaredNorm() / variance;
    z.residuals = 3;
    return z;
  }
};

int main() {
  chainslam::Ieskf<State, ConstantVelocity> filter;
  filter.predict(1.0, 0.1);
  MeasuredPosition measured{Eigen::Vector3d::Ones(), 0.01};
  return filter.update(measured).accepted() ? 0 : 1;
}
