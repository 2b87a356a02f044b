#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <deque>
#include <limits>
#include <optional>
#include <span>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/odometry/detail/alignment_block.hpp"
#include "chainslam/odometry/detail/alignment_equations.hpp"

namespace chainslam::detail {

/// All that an alignment is solved from.
struct AlignmentProblem {
  const ImuTrack& track;
  std::span<const AlignmentPose> poses;
  std::span<const std::size_t> ends;      ///< one past the last pose of each block
  const std::deque<AlignmentBlock>& old;  ///< equations of poses before these
  Eigen::Vector3d imu_position;           ///< metres, in the LiDAR's frame
  AlignmentState given;
  AlignmentMatrix given_information;
  bool rotation_given = false;  ///< otherwise its information limits the deviation, but draws the rotation nowhere
  double max_offset = 0.25;     ///< s
};

/// A solution from one start, and what it rests on.
struct AlignmentSolution {
  AlignmentState state;
  AlignmentScales scales;
  std::vector<BlockResiduals> residuals;
  std::vector<AlignmentBlock> blocks;
};

/// Robust scales of the residuals along each axis: 1.4826 times the median of their sizes.
[[nodiscard]] inline AlignmentScales scales_of(std::span<const BlockResiduals> blocks) {
  std::array<std::vector<double>, 3> turns, forces;
  for (const BlockResiduals& block : blocks) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      for (const auto& turn : block.turns)
        if (turn) turns[axis].push_back(std::abs(turn->value[static_cast<Eigen::Index>(axis)]));
      for (const auto& force : block.forces)
        if (force) forces[axis].push_back(std::abs(force->value[static_cast<Eigen::Index>(axis)]));
    }
  }
  AlignmentScales scales;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    scales.turn[axis] = std::max(1e-5, 1.4826 * median(turns[axis]));
    scales.force[axis] = std::max(1e-3, 1.4826 * median(forces[axis]));
  }
  return scales;
}

/// Gauss-Newton steps whose robust kernel is wide at first: from far away what is informative looks like an outlier.
constexpr int wide_steps = 3;

template <Executor E>
void linearize(const AlignmentProblem& problem, AlignmentSolution& solution, int step, const E& executor) {
  const ImuAlignmentEquations equations(problem.track, problem.poses, solution.state, problem.imu_position, executor);
  solution.residuals.resize(problem.ends.size());
  executor.for_chunks(to_index(problem.ends.size()), 1, [&](Index block, Index /*end*/) {
    const auto k = static_cast<std::size_t>(block);
    solution.residuals[k] =
        block_residuals(equations, problem.poses, k == 0 ? 0 : problem.ends[k - 1], problem.ends[k]);
  });
  solution.scales = scales_of(solution.residuals);
  AlignmentScales widened = solution.scales;
  const double width = std::max(1.0, std::exp2(wide_steps - step));
  for (std::size_t axis = 0; axis < 3; ++axis) {
    widened.turn[axis] *= width;
    widened.force[axis] *= width;
  }
  solution.blocks.resize(problem.ends.size());
  executor.for_chunks(to_index(problem.ends.size()), 1, [&](Index block, Index /*end*/) {
    const auto k = static_cast<std::size_t>(block);
    solution.blocks[k] = normal_equations(solution.residuals[k], problem.poses, solution.state, widened);
  });
}

/// The Gauss-Newton step from where the solution was linearized.
[[nodiscard]] inline AlignmentVector newton_step(const AlignmentProblem& problem, const AlignmentSolution& solution) {
  AlignmentMatrix information = problem.given_information;
  AlignmentVector off = local(problem.given, solution.state);
  if (!problem.rotation_given) off[1] = off[2] = off[3] = 0;
  AlignmentVector gradient = product(information, off);
  for (const AlignmentBlock& block : problem.old) {
    information = sum_of(information, block.information);
    gradient = sum_of(gradient, block.gradient_at(solution.state));
  }
  for (const AlignmentBlock& block : solution.blocks) {
    information = sum_of(information, block.information);
    gradient = sum_of(gradient, block.gradient);
  }
  return negative(product(spd_inverse(information), gradient));
}

/// @param first_step  0 from far away, `wide_steps` from a state that is nearly right.
template <Executor E>
[[nodiscard]] AlignmentSolution refined(const AlignmentProblem& problem, const AlignmentState& start, int first_step,
                                        const E& executor) {
  constexpr int last_step = 8;
  constexpr double converged = 1e-5;  // s, rad, rad/s, m/s^2
  AlignmentSolution solution;
  solution.state = start;
  for (int step = first_step;; ++step) {
    linearize(problem, solution, step, executor);
    if (step >= last_step) return solution;
    const AlignmentVector change = newton_step(problem, solution);
    solution.state = retract(solution.state, change);
    solution.state.time_offset = std::clamp(solution.state.time_offset, -problem.max_offset, problem.max_offset);
    if (step > wide_steps && change.norm() < converged) step = last_step - 1;
  }
}

/// Mean of Cauchy's loss over all residuals at the scales given, by which solutions compare.
[[nodiscard]] inline double misfit(const AlignmentSolution& solution, const AlignmentScales& scales) {
  double sum = 0, count = 0;
  const auto add = [&](const std::optional<AlignmentResidual>& residual, const std::array<double, 3>& scale) {
    if (!residual) return;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const double off = residual->value[static_cast<Eigen::Index>(axis)] / (cauchy_width * scale[axis]);
      sum += std::log1p(off * off);
      ++count;
    }
  };
  for (const BlockResiduals& block : solution.residuals) {
    for (const auto& turn : block.turns) add(turn, scales.turn);
    for (const auto& force : block.forces) add(force, scales.force);
  }
  return count > 0 ? sum / count : std::numeric_limits<double>::infinity();
}

[[nodiscard]] inline const AlignmentSolution& best_of(std::span<const AlignmentSolution> solutions) {
  AlignmentScales least = solutions.front().scales;
  for (const AlignmentSolution& solution : solutions)
    for (std::size_t axis = 0; axis < 3; ++axis) {
      least.turn[axis] = std::min(least.turn[axis], solution.scales.turn[axis]);
      least.force[axis] = std::min(least.force[axis], solution.scales.force[axis]);
    }
  const AlignmentSolution* best = &solutions.front();
  for (const AlignmentSolution& solution : solutions)
    if (misfit(solution, least) < misfit(*best, least)) best = &solution;
  return *best;
}

/// Covariance of an M-estimate whose residuals depend on each other within a block (sandwich, Liang and Zeger 1986,
/// eq. 8). Sums of a few blocks scatter: they count beside what independent residuals would give, inflated as much as
/// the scatter of 30 s windows of KITTI's drives exceeded that.
[[nodiscard]] inline AlignmentMatrix sandwich(const AlignmentProblem& problem, const AlignmentSolution& solution) {
  constexpr double turn_inflation = 1.5, force_inflation = 10, as_many_blocks = 10;
  AlignmentMatrix information = zeros<AlignmentMatrix>(), squares = zeros<AlignmentMatrix>();
  AlignmentMatrix turns = zeros<AlignmentMatrix>();
  double blocks = 0;
  const auto add = [&](const AlignmentBlock& block) {
    information = sum_of(information, block.information);
    turns = sum_of(turns, block.turn_information);
    const AlignmentVector gradient = block.gradient_at(solution.state);
    squares = sum_of(squares, product_transposed(gradient, gradient));
    ++blocks;
  };
  for (const AlignmentBlock& block : problem.old) add(block);
  for (const AlignmentBlock& block : solution.blocks) add(block);
  const AlignmentMatrix expected = scaled(
      1 / blocks, sum_of(scaled(turn_inflation, turns), scaled(force_inflation, difference_of(information, turns))));
  AlignmentMatrix scatter =
      scaled(blocks / (blocks + as_many_blocks), sum_of(squares, scaled(as_many_blocks, expected)));
  scatter = sum_of(scatter, problem.given_information);
  information = sum_of(information, problem.given_information);
  return congruent(spd_inverse(information), scatter);
}

}  // namespace chainslam::detail
