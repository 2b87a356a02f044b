#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/symmetric_eigen.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/umeyama.hpp"
#include "chainslam/odometry/detail/alignment_block.hpp"
#include "chainslam/odometry/detail/alignment_equations.hpp"

namespace chainslam::detail {

/// Vectors of the body and of the LiDAR that the rotation must bring together, and how far their lengths differ at the
/// best offset.
struct AlignmentPairs {
  std::vector<Eigen::Vector3d> lidar;
  std::vector<std::vector<std::optional<Eigen::Vector3d>>> body;  ///< for each offset of the grid
  std::vector<double> mismatch;

  void add(const Eigen::Vector3d& vector) {
    lidar.push_back(vector);
    mismatch.push_back(std::numeric_limits<double>::infinity());
  }
  /// At the next offset.
  void add_body(std::vector<std::optional<Eigen::Vector3d>> vectors) {
    for (std::size_t j = 0; j < vectors.size(); ++j)
      if (vectors[j]) mismatch[j] = std::min(mismatch[j], std::abs(vectors[j]->norm() - lidar[j].norm()));
    body.push_back(std::move(vectors));
  }
};

/// Takes the means over each block off forces: gravity and bias, as long as the attitude hardly changes.
inline void centre(std::vector<std::optional<Eigen::Vector3d>>& vectors, std::span<const std::size_t> ends) {
  std::size_t begin = 0;
  for (const std::size_t end : ends) {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    int count = 0;
    for (std::size_t i = begin; i < end; ++i)
      if (vectors[i]) sum += *vectors[i], ++count;
    for (std::size_t i = begin; i < end; ++i)
      if (vectors[i]) *vectors[i] -= sum / count;
    begin = end;
  }
}

/// What the IMU measured of the poses' turns and forces at one offset.
struct BodyVectors {
  std::vector<std::optional<Eigen::Vector3d>> turns, forces;

  BodyVectors() = default;
  BodyVectors(const ImuTrack& track, std::span<const AlignmentPose> poses, std::span<const std::size_t> ends,
              double offset) {
    TrackPoints points(poses.size());
    find_points(track, poses, offset, 0, to_index(poses.size()), points);
    for (std::size_t j = 0; j < poses.size(); ++j) {
      const auto before = j - static_cast<std::size_t>(poses[j].turned);
      const bool turned = before < j && in_one_run(points, before, j);
      turns.push_back(turned ? std::optional(body_turn(*points[before], *points[j])) : std::nullopt);
      forces.push_back(std::nullopt);
      if (poses[j].right == 0 || static_cast<std::size_t>(poses[j].left) > j || !points[j]) continue;
      const std::size_t i = j - static_cast<std::size_t>(poses[j].left);
      const std::size_t k = j + static_cast<std::size_t>(poses[j].right);
      if (k < poses.size() && in_one_run(points, i, k))
        forces.back() = body_force(*points[i], *points[j], *points[k], poses[j].time - poses[i].time,
                                   poses[k].time - poses[j].time);
    }
    centre(forces, ends);
  }
};

/// Sums for Wahba's problem at one offset.
struct WahbaSums {
  Eigen::Matrix3d S = zeros<Eigen::Matrix3d>();  ///< of LiDAR vectors times the transposed body vectors
  double squares = 0, weight = 0;

  void add(const AlignmentPairs& pairs, std::size_t offset, double floor) {
    std::vector<double> known;
    for (const double m : pairs.mismatch)
      if (std::isfinite(m)) known.push_back(m);
    const double scale = std::max(floor, 1.5 * median(known));
    for (std::size_t i = 0; i < pairs.lidar.size(); ++i) {
      const auto& body = pairs.body[offset][i];
      if (!body) continue;
      const double w = robust_weight(pairs.mismatch[i], scale * scale);
      S = sum_of(S, product_transposed(scaled(w, pairs.lidar[i]), *body));
      squares += w * (pairs.lidar[i].squaredNorm() + body->squaredNorm());
      weight += w * scale * scale;
    }
  }
};

struct AlignmentSearch {
  AlignmentState state;
  /// By how much the squared error of offsets farther away than `apart` exceeds the least, over its mean per residual:
  /// (apart / deviation)^2 where there is motion, a few where there is only noise, whose least is anywhere.
  double contrast = 0;
  static constexpr double apart = 0.06;  ///< s
};

/// Offset and rotation by trying offsets over their whole range, each with the best rotation in closed form (Horn
/// 1987): turns for themselves (Zhu et al. 2022, eq. 6) and, as a car turns about one axis only, forces less their mean
/// over each block beside them.
///
/// @param ends  one past the last pose of each block.
/// @returns nothing without a turn that IMU and LiDAR both measured.
template <Executor E>
[[nodiscard]] std::optional<AlignmentSearch> search_alignment(const ImuTrack& track,
                                                              std::span<const AlignmentPose> poses,
                                                              std::span<const std::size_t> ends, double max_offset,
                                                              const E& executor) {
  constexpr double step = 0.02, turn_floor = 0.001, force_floor = 0.1;  // s, rad, m/s^2
  const int half = static_cast<int>(std::lround(max_offset / step));
  AlignmentPairs turns, forces;
  std::vector<std::optional<Eigen::Vector3d>> accel;
  for (const AlignmentPose& pose : poses) {
    turns.add(pose.turn);
    accel.push_back(pose.right > 0 ? std::optional(pose.accel) : std::nullopt);
  }
  centre(accel, ends);
  for (const auto& a : accel) forces.add(a.value_or(Eigen::Vector3d::Zero()));
  std::vector<BodyVectors> body(static_cast<std::size_t>(2 * half + 1));
  executor.for_chunks(to_index(body.size()), 1, [&](Index begin, Index /*end*/) {
    body[static_cast<std::size_t>(begin)] = BodyVectors(track, poses, ends, (begin - half) * step);
  });
  for (BodyVectors& at_offset : body) {
    turns.add_body(std::move(at_offset.turns));
    forces.add_body(std::move(at_offset.forces));
  }
  std::optional<AlignmentSearch> best;
  std::vector<double> costs;
  double residuals = 0;
  for (int d = -half; d <= half; ++d) {
    WahbaSums sums;
    sums.add(turns, static_cast<std::size_t>(d + half), turn_floor);
    costs.push_back(std::numeric_limits<double>::infinity());
    if (!(sums.weight > 0)) continue;
    sums.add(forces, static_cast<std::size_t>(d + half), force_floor);
    const JacobiEigen<double, 4> eigen = jacobi_eigen(horn_matrix(sums.S));
    costs.back() = (sums.squares - 2 * eigen.values[3]) / sums.weight;
    if (*std::min_element(costs.begin(), costs.end()) < costs.back()) continue;
    residuals = 3 * sums.weight;
    const Eigen::Vector4d q = eigen.vectors.col(3);
    best.emplace();
    best->state.time_offset = d * step;
    best->state.R_body_lidar = SO3d::from_quaternion(SO3d::Quaternion(q)).inverse();
  }
  if (!best) return best;
  const double least = *std::min_element(costs.begin(), costs.end());
  double next = std::numeric_limits<double>::infinity();
  for (int d = -half; d <= half; ++d)
    if (std::abs(d * step - best->state.time_offset) > AlignmentSearch::apart)
      next = std::min(next, costs[static_cast<std::size_t>(d + half)]);
  best->contrast = residuals * (next - least) / least;
  return best;
}

}  // namespace chainslam::detail
