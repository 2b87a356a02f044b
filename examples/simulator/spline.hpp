#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>
#include <vector>

namespace chainslam::simulator {

/// A uniform B-spline of degree 5: four continuous derivatives, so that rates and accelerations are smooth too.
///
/// It follows its control points and rounds what changes within about two steps. Control point i has most weight at
/// (i - 2) * step.
template <int Dimension>
class Spline {
 public:
  using Vector = Eigen::Matrix<double, Dimension, 1>;

  struct Point {
    Vector value;
    Vector rate;          ///< first derivative, per second
    Vector acceleration;  ///< second derivative, per second squared
  };

  /// How much each of the six control points around counts for value, first and second derivative (by u).
  using Weights = Eigen::Matrix<double, 6, 3>;

  /// @param u  part of the segment that has passed, 0 to 1.
  [[nodiscard]] static Weights weights_at(double u) {
    // The basis in powers of u (Qin 1998, general matrix for uniform B-splines), times 120.
    static const Eigen::Matrix<double, 6, 6> basis = (Eigen::Matrix<double, 6, 6>() << 1, 26, 66, 26, 1, 0,  //
                                                      -5, -50, 0, 50, 5, 0,                                  //
                                                      10, 20, -60, 20, 10, 0,                                //
                                                      -10, 20, 0, -20, 10, 0,                                //
                                                      5, -20, 30, -20, 5, 0,                                 //
                                                      -1, 5, -10, 10, -5, 1)
                                                         .finished();
    Weights powers;
    powers << 1.0, 0.0, 0.0,                           //
        u, 1.0, 0.0,                                   //
        u * u, 2.0 * u, 2.0,                           //
        u * u * u, 3.0 * u * u, 6.0 * u,               //
        u * u * u * u, 4.0 * u * u * u, 12.0 * u * u,  //
        u * u * u * u * u, 5.0 * u * u * u * u, 20.0 * u * u * u;
    return basis.transpose() * powers / 120.0;
  }

  /// @param step  seconds between control points.
  /// @throws std::invalid_argument with fewer than 6 control points.
  Spline(std::vector<Vector> controls, double step) : controls_(std::move(controls)), step_(step) {
    if (controls_.size() < 6) throw std::invalid_argument("Spline: needs at least 6 control points");
  }

  /// Seconds from the first to the last time at which it is defined.
  [[nodiscard]] double duration() const { return static_cast<double>(controls_.size() - 5) * step_; }

  /// @param time  seconds; beyond the ends, the end's polynomial goes on.
  [[nodiscard]] Point at(double time) const {
    const double last = static_cast<double>(controls_.size() - 6);
    const double segment = std::clamp(std::floor(time / step_), 0.0, last);
    const double u = time / step_ - segment;
    const Weights weights = weights_at(u);
    Point point{Vector::Zero(), Vector::Zero(), Vector::Zero()};
    for (int i = 0; i < 6; ++i) {
      const Vector& control = controls_[static_cast<std::size_t>(segment) + static_cast<std::size_t>(i)];
      point.value += weights(i, 0) * control;
      point.rate += weights(i, 1) / step_ * control;
      point.acceleration += weights(i, 2) / (step_ * step_) * control;
    }
    return point;
  }

 private:
  std::vector<Vector> controls_;
  double step_;
};

}  // namespace chainslam::simulator
