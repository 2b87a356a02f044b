#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <optional>
#include <vector>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/odometry/detail/alignment_equations.hpp"

namespace chainslam::detail {

/// Standard deviations of residuals along the LiDAR's axes, robust: turns in rad, forces in m/s^2.
struct AlignmentScales {
  std::array<double, 3> turn{0.002, 0.002, 0.002}, force{0.3, 0.3, 0.3};
};

/// Normal equations of some seconds of poses about a state, gravity eliminated.
struct AlignmentBlock {
  AlignmentState at;  ///< where they were linearized
  AlignmentMatrix information = zeros<AlignmentMatrix>();
  AlignmentMatrix turn_information = zeros<AlignmentMatrix>();  ///< the part of it that turns give
  AlignmentVector gradient = zeros<AlignmentVector>();
  Eigen::Vector3d up_force = Eigen::Vector3d::Zero();  ///< specific force at rest, in the frame of the poses
  double begin = 0, end = 0;                           ///< s
  int turns = 0, forces = 0;

  [[nodiscard]] AlignmentVector gradient_at(const AlignmentState& x) const {
    return sum_of(gradient, product(information, local(at, x)));
  }
};

[[nodiscard]] inline double median(std::vector<double>& values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// Residuals of a block of poses: [first, last).
struct BlockResiduals {
  std::size_t first = 0, last = 0;
  std::vector<std::optional<AlignmentResidual>> turns, forces;
  Eigen::Vector3d up_force = Eigen::Vector3d::Zero();
};

/// Residuals of all poses of a block. What gravity adds to each force is the median over the block: outliers do not
/// move it.
[[nodiscard]] inline BlockResiduals block_residuals(const ImuAlignmentEquations& equations,
                                                    std::span<const AlignmentPose> poses, std::size_t first,
                                                    std::size_t last) {
  BlockResiduals block;
  block.first = first;
  block.last = last;
  std::array<std::vector<double>, 3> up;
  for (std::size_t j = first; j < last; ++j) {
    block.turns.push_back(equations.turn(j));
    block.forces.push_back(equations.force(j));
    if (!block.forces.back()) continue;
    const Eigen::Vector3d force = poses[j].R * block.forces.back()->value;
    for (int axis = 0; axis < 3; ++axis) up[static_cast<std::size_t>(axis)].push_back(force[axis]);
  }
  for (int axis = 0; axis < 3; ++axis) block.up_force[axis] = median(up[static_cast<std::size_t>(axis)]);
  for (std::size_t j = first; j < last; ++j)
    if (auto& force = block.forces[j - first]; force)
      force->value = difference_of(force->value, poses[j].R.inverse() * block.up_force);
  return block;
}

constexpr double cauchy_width = 2.3849;  ///< standard deviations: 95 % efficiency for Gaussian noise

/// Weight of a component that is off by `residual`: Cauchy's, so that the far ones do not count.
[[nodiscard]] inline double robust_weight(double residual, double variance) {
  return 1 / (variance + residual * residual / (cauchy_width * cauchy_width));
}

/// Sums a block's equations and eliminates its gravity by Schur's complement.
[[nodiscard]] inline AlignmentBlock normal_equations(const BlockResiduals& residuals,
                                                     std::span<const AlignmentPose> poses, const AlignmentState& x,
                                                     const AlignmentScales& scales) {
  constexpr int n = AlignmentState::dof;
  AlignmentBlock block{.at = x, .up_force = residuals.up_force};
  block.begin = poses[residuals.first].time;
  block.end = poses[residuals.last - 1].time;
  const auto add = [&](const double* row, double value, double weight) {
    for (int b = 0; b < n; ++b) {
      const double weighted = weight * row[3 * b];
      if (weighted == 0) continue;
      for (int a = 0; a < n; ++a) block.information(a, b) += row[3 * a] * weighted;
      block.gradient[b] += weighted * value;
    }
  };
  auto gravity = zeros<Eigen::Matrix3d>();
  Eigen::Vector3d gravity_gradient = Eigen::Vector3d::Zero();
  auto coupling = zeros<Eigen::Matrix<double, n, 3>>();
  for (std::size_t j = residuals.first; j < residuals.last; ++j) {
    if (const auto& turn = residuals.turns[j - residuals.first]; turn) {
      ++block.turns;
      for (int axis = 0; axis < 3; ++axis) {
        const double scale = scales.turn[static_cast<std::size_t>(axis)];
        // Rotations over several poses overlap: each pose's share of the way is in as many of them.
        add(turn->by_state.data() + axis, turn->value[axis],
            robust_weight(turn->value[axis], scale * scale + poses[j].turn_variance) / poses[j].turned);
      }
    }
  }
  block.turn_information = block.information;
  for (std::size_t j = residuals.first; j < residuals.last; ++j) {
    if (const auto& force = residuals.forces[j - residuals.first]; force) {
      ++block.forces;
      // Second differences overlap in any case. Where rotations do as well, both are divided, so that their relative
      // weights stay.
      const double shared = poses[j].turned > 1 ? poses[j].left + poses[j].right : 1;
      const Eigen::Matrix3d by_up = negative(poses[j].R.inverse().matrix());
      for (int axis = 0; axis < 3; ++axis) {
        const double scale = scales.force[static_cast<std::size_t>(axis)];
        const double weight = robust_weight(force->value[axis], scale * scale + poses[j].accel_variance) / shared;
        add(force->by_state.data() + axis, force->value[axis], weight);
        for (int b = 0; b < 3; ++b) {
          const double weighted = weight * by_up(axis, b);
          for (int a = 0; a < n; ++a) coupling(a, b) += force->by_state(axis, a) * weighted;
          for (int a = 0; a < 3; ++a) gravity(a, b) += by_up(axis, a) * weighted;
          gravity_gradient[b] += weighted * force->value[axis];
        }
      }
    }
  }
  if (block.forces > 0) {
    constexpr double standard = 9.80665,
                     deviation = 0.05;  // m/s^2, over the Earth's surface and with the scale's error
    const double size = residuals.up_force.norm();
    const Eigen::Vector3d up = residuals.up_force / size;
    const double weight = 1 / (deviation * deviation);
    gravity = sum_of(gravity, product_transposed(scaled(weight, up), up));
    gravity_gradient = sum_of(gravity_gradient, scaled(weight * (size - standard), up));
  }
  for (int i = 0; i < 3; ++i) gravity(i, i) += 1e-6;  // without a force there is none
  const Eigen::Matrix3d root = solved_right(identity<Eigen::Matrix3d>(), cholesky(gravity));
  const Eigen::Matrix<double, n, 3> whitened = product(coupling, root);
  block.information = difference_of(block.information, product_transposed(whitened, whitened));
  block.gradient = difference_of(block.gradient, product(whitened, transposed_product(root, gravity_gradient)));
  return block;
}

}  // namespace chainslam::detail
