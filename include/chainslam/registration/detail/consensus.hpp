#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/lanes.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/registration/alignment_checks.hpp"
#include "chainslam/registration/concepts.hpp"
#include "chainslam/registration/matched_points.hpp"

namespace chainslam {

namespace detail {

/// All matches judged in full, in double.
[[nodiscard]] inline Hypothesis judge(const MatchedPoints& points, const SE3d& T, double max_distance) {
  const Eigen::Matrix3d R = T.rotation().matrix();
  const Eigen::Vector3d t = T.translation();
  const double largest = max_distance * max_distance;
  Hypothesis judged{.T_target_source = T};
  for (std::size_t i = 0; i < points.source.size(); ++i) {
    const Eigen::Vector3d moved = product(R, points.source[i]) + t;
    const double squared = squared_distance<3>(moved.data(), points.target[i].data());
    if (!(squared <= largest)) continue;
    ++judged.consensus;
    judged.gain += largest - squared;
  }
  return judged;
}

/// Which matches a pose brings to within `max_distance`: 1, else 0.
[[nodiscard]] inline std::vector<double> agreeing(const MatchedPoints& points, const SE3d& T, double max_distance) {
  std::vector<double> weights(points.source.size());
  for (std::size_t i = 0; i < weights.size(); ++i) {
    const Eigen::Vector3d moved = T * points.source[i];
    const double squared = squared_distance<3>(moved.data(), points.target[i].data());
    weights[i] = squared <= max_distance * max_distance ? 1.0 : 0.0;
  }
  return weights;
}

/// The matches in columns of floats about their middle, for judging many poses fast.
class MatchTable {
 public:
  /// @param order  in which matches come; all of them once.
  MatchTable(const MatchedPoints& points, const std::vector<Index>& order)
      : size_(points.source.size()), padded_(whole_lanes(size_)) {
    const double share = 1.0 / static_cast<double>(size_);
    for (const Eigen::Vector3d& p : points.source) source_middle_ += share * p;
    for (const Eigen::Vector3d& p : points.target) target_middle_ += share * p;
    for (std::size_t axis = 0; axis < 6; ++axis) columns_[axis].assign(padded_, axis < 3 ? 0.0F : far);
    for (std::size_t i = 0; i < size_; ++i) {
      const auto from = static_cast<std::size_t>(order[i]);
      const Eigen::Vector3d p = points.source[from] - source_middle_, q = points.target[from] - target_middle_;
      for (std::size_t axis = 0; axis < 3; ++axis) {
        columns_[axis][i] = static_cast<float>(p[static_cast<Eigen::Index>(axis)]);
        columns_[3 + axis][i] = static_cast<float>(q[static_cast<Eigen::Index>(axis)]);
      }
    }
  }

  [[nodiscard]] std::size_t size() const { return size_; }

  /// A pose as the columns take it.
  struct Pose {
    std::array<std::array<float, 3>, 3> R;
    std::array<float, 3> t;
  };
  [[nodiscard]] Pose centered(const SE3d& T) const {
    const Eigen::Matrix3d R = T.rotation().matrix();
    const Eigen::Vector3d t = T * source_middle_ - target_middle_;
    Pose pose{};
    for (std::size_t row = 0; row < 3; ++row) {
      for (std::size_t column = 0; column < 3; ++column)
        pose.R[row][column] = static_cast<float>(R(static_cast<Eigen::Index>(row), static_cast<Eigen::Index>(column)));
      pose.t[row] = static_cast<float>(t[static_cast<Eigen::Index>(row)]);
    }
    return pose;
  }

  /// Adds the gain and the count of matches [begin, end), whole registers, that the pose brings together.
  void add_gain(const Pose& pose, float squared_distance, std::size_t begin, std::size_t end, double& gain,
                Index& count) const {
    FloatLanes sum{};
    MaskLanes agree{};
    for (std::size_t i = begin; i < std::min(end, padded_); i += lane_count) {
      FloatLanes x, y, z, target;
      load(&columns_[0][i], x);
      load(&columns_[1][i], y);
      load(&columns_[2][i], z);
      FloatLanes squared{};
      for (std::size_t axis = 0; axis < 3; ++axis) {
        load(&columns_[3 + axis][i], target);
        const FloatLanes d = pose.R[axis][0] * x + pose.R[axis][1] * y + pose.R[axis][2] * z + pose.t[axis] - target;
        squared += d * d;
      }
      const FloatLanes rest = squared_distance - squared, none{};
      const MaskLanes near = rest >= none;
      FloatLanes gained;
      choose(near, rest, none, gained);
      sum += gained;
      agree += near;
    }
    for (std::size_t lane = 0; lane < lane_count; ++lane) gain += static_cast<double>(sum[lane]);
    count -= detail::sum(agree);
  }

 private:
  static constexpr float far = 1e15F;  ///< squared still a float; where there is no match

  std::size_t size_, padded_;
  Eigen::Vector3d source_middle_ = Eigen::Vector3d::Zero(), target_middle_ = Eigen::Vector3d::Zero();
  std::array<std::vector<float>, 6> columns_;
};

/// What to tell of a hypothesis: its consensus, and how much of the clouds lies together.
template <Cloud Source, NearestNeighborSearch Target, Executor Exec>
void report(GlobalAlignResult& result, const Hypothesis& best, const Source& source, const Target& target,
            double max_distance, const Exec& executor) {
  result.status = GlobalAlignStatus::found;
  result.T_target_source = best.T_target_source;
  result.consensus = best.consensus;
  result.putative_ratio = result.matches > 0 ? static_cast<double>(best.consensus) / result.matches : 0.0;
  const chainslam::Overlap overlap = measure_overlap(source, target, best.T_target_source, max_distance, executor);
  result.inliers = overlap.inliers;
  result.fitness_target = overlap.share_of_target;
  result.fitness_source = overlap.share_of_source;
  result.inlier_rmse = overlap.rmse;
}

}  // namespace detail
}  // namespace chainslam
