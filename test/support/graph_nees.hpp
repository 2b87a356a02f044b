#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/sensor/frame.hpp"
#include "chainslam/slam/map_graph.hpp"
#include "chainslam/trajectory/pose_errors.hpp"

namespace chainslam::test {

/// By how much the relative poses of a drive are off, over what a back end's steps between keyframes make of it: the
/// median's deviations, so that outliers, which the graph finds by other means, do not decide. 1: as expected.
struct NeesRatio {
  double translation = 0, rotation = 0;
  std::size_t count = 0;
};

namespace internal {

/// The root of a median of squared errors per degree of freedom, three of them, over that of a chi-squared.
inline double deviations(std::vector<double> nees) {
  constexpr double median_of_chi_squared = 2.366;
  if (nees.empty()) return 0;
  std::ranges::nth_element(nees, nees.begin() + static_cast<std::ptrdiff_t>(nees.size() / 2));
  return std::sqrt(nees[nees.size() / 2] / median_of_chi_squared);
}

}  // namespace internal

/// What a back end made of a drive: its steps between keyframes, with the truth of each keyframe.
class GraphNees {
 public:
  /// @param frames    a session, as odometry or a recording has it.
  /// @param truth     T_world_body of each frame.
  /// @param distance  metres between keyframes, which are never lost frames.
  GraphNees(std::span<const FrameRecord> frames, std::span<const SE3d> truth, double distance,
            const MapGraphOptions& options = {}) {
    MapGraph<> graph(options);
    std::size_t taken = 0;
    for (std::size_t i = 0; i < frames.size(); ++i) {
      const SE3d& T = frames[i].T_odom_body;
      if (frames[i].health.status == FrameStatus::lost) continue;
      if (!poses_.empty() && (poses_.back().inverse() * T).translation().norm() < distance) continue;
      graph.append(frames.subspan(taken, i + 1 - taken));
      graph.append(Keyframe{.time = frames[i].time, .T_odom_body = T});
      taken = i + 1;
      poses_.push_back(T);
      truth_.push_back(truth[i]);
    }
    for (const OdometryMeasurement& step : graph.map().odometry) {
      const Matrix6d root = Matrix6d(step.sqrt_information).inverse();
      steps_.push_back(root * root.transpose());
    }
  }

  /// Over relative poses at least so many metres apart along the way.
  [[nodiscard]] NeesRatio over(double metres) const {
    const std::vector<double> way = path_lengths(poses_);
    std::vector<double> translation, rotation;
    for (std::size_t i = 0; i < poses_.size(); ++i) {
      Matrix6d covariance = Matrix6d::Zero();
      std::size_t j = i;
      for (; j + 1 < poses_.size() && way[j] - way[i] < metres; ++j) {
        const Matrix6d carry = (poses_[j + 1].inverse() * poses_[j]).adjoint();
        covariance = (carry * covariance * carry.transpose() + steps_[j]).eval();
      }
      if (way[j] - way[i] < metres) break;
      const Vector6d error = (truth_[i].inverse() * truth_[j]).local(poses_[i].inverse() * poses_[j]);
      const auto nees = [&](int first) {
        const Eigen::Vector3d e = error.segment<3>(first);
        return e.dot(covariance.block<3, 3>(first, first).ldlt().solve(e));
      };
      translation.push_back(nees(0));
      rotation.push_back(nees(3));
    }
    return {internal::deviations(translation), internal::deviations(rotation), translation.size()};
  }

 private:
  std::vector<SE3d> poses_, truth_;  ///< of keyframes
  std::vector<Matrix6d> steps_;      ///< covariances
};

}  // namespace chainslam::test
