#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam {

/// How many points were left out of scans, and why.
struct ScanFilterCounts {
  std::int64_t not_finite = 0;  ///< a coordinate or the time is NaN or infinite
  std::int64_t zero = 0;        ///< exactly (0, 0, 0): many drivers write that for no return
  std::int64_t near = 0;        ///< inside the blind radius
  std::int64_t far = 0;         ///< beyond the maximum range
  std::int64_t thinned = 0;     ///< usable, but not an n-th point
};

/// Drops what odometry should not see: broken returns, the vehicle's own body, far noise.
struct ScanFilter {
  double min_range = 1.0;    ///< metres from the sensor: the blind radius
  double max_range = 120.0;  ///< metres from the sensor
  Index every = 1;           ///< keep each n-th of the usable points

  /// @param sweep  n points, lidar frame.
  /// @returns the points kept, in their order, with times and intensities; what went is added to `counts`.
  /// @throws std::invalid_argument if a column's length is neither 0 nor n, or `every` < 1.
  [[nodiscard]] PointCloud<float> apply(const PointCloud<float>& sweep, ScanFilterCounts& counts) const {
    const auto fits = [&](const auto& column) { return column.empty() || column.size() == sweep.size(); };
    if (!fits(sweep.time_offsets) || !fits(sweep.intensities) || !fits(sweep.normals))
      throw std::invalid_argument("ScanFilter: a column of the scan is neither empty nor as long as its positions");
    if (every < 1) throw std::invalid_argument("ScanFilter: every must be at least 1");
    const bool timed = sweep.has_times();
    std::vector<Index> kept;
    kept.reserve(sweep.size());
    Index usable = 0;
    for (std::size_t i = 0; i < sweep.size(); ++i) {
      const Eigen::Vector3d p = converted<double>(sweep.positions[i]);
      const double squared_range = p.squaredNorm();
      if (!is_finite(squared_range) || (timed && !is_finite(sweep.time_offsets[i])))
        ++counts.not_finite;
      else if (squared_range == 0)
        ++counts.zero;
      else if (squared_range < min_range * min_range)
        ++counts.near;
      else if (squared_range > max_range * max_range)
        ++counts.far;
      else if (usable++ % every != 0)
        ++counts.thinned;
      else
        kept.push_back(static_cast<Index>(i));
    }
    return select(sweep, kept);
  }
};

/// The body's motion during a sweep, as poses relative to the sweep's end, evenly spaced in time.
///
/// `T_end_body[k]` is the body's pose at k / (size - 1) of the duration, in the body frame of the sweep's end; the last
/// is the identity. Between two knots points are carried linearly: with steps of at most `knot_angle` radians that is
/// within range * knot_angle^2 / 8 of the exact arc (0.1 mm at 100 m for 3 mrad).
struct SweepMotion {
  static constexpr double knot_angle = 0.003;  ///< radians between knots

  double duration = 0;           ///< seconds from the scan's stamp to its end
  std::vector<SE3d> T_end_body;  ///< at least two knots

  /// Samples a motion. @param pose  `SE3d pose(double time_offset)`: T_end_body at seconds from the scan's stamp.
  /// @param angle  radians turned in the whole sweep; sets the number of knots.
  template <std::invocable<double> Pose>
  [[nodiscard]] static SweepMotion sample(double duration, double angle, Pose&& pose) {
    SweepMotion motion = still(duration, angle);
    const std::size_t pieces = motion.T_end_body.size() - 1;
    for (std::size_t k = 0; k <= pieces; ++k)
      motion.T_end_body[k] = pose(duration * static_cast<double>(k) / static_cast<double>(pieces));
    return motion;
  }

  /// Constant twist (per second, body frame, [translation; rotation]) through the whole sweep.
  [[nodiscard]] static SweepMotion constant_twist(double duration, const Vector6d& twist) {
    return sample(duration, block_of<3, 1>(twist, 3, 0).norm() * duration,
                  [&](double t) { return SE3d::exp(scaled(t - duration, twist)); });
  }

 private:
  /// No motion, with as many knots as one by that angle needs.
  [[nodiscard]] static SweepMotion still(double duration, double angle) {
    const auto pieces = static_cast<std::size_t>(std::clamp(std::ceil(angle / knot_angle), 8.0, 2048.0));
    return {duration, std::vector<SE3d>(pieces + 1)};
  }
};

/// Brings every point of a sweep to where it would have been seen at the sweep's end.
///
/// @param sweep   n points, lidar frame, metres. Without time offsets it counts as a snapshot at the end.
/// @param motion  of the body during the sweep; time offsets beyond it are held at its ends.
/// @returns n points in the same order, body frame at the sweep's end; time offsets and intensities are kept.
template <Executor E = Serial>
[[nodiscard]] PointCloud<float> deskew(const PointCloud<float>& sweep, const SweepMotion& motion,
                                       const SE3d& T_body_lidar = {}, const E& executor = {}) {
  constexpr Index grain = 4096;
  struct Affine {
    Eigen::Matrix3d R;
    Eigen::Vector3d t;
  };
  std::vector<Affine> knots;
  knots.reserve(motion.T_end_body.size());
  for (const SE3d& T_end_body : motion.T_end_body) {
    const SE3d T_end_lidar = T_end_body * T_body_lidar;
    knots.push_back({T_end_lidar.rotation().matrix(), T_end_lidar.translation()});
  }
  const bool timed = sweep.has_times() && motion.duration > 0;
  const double last = static_cast<double>(knots.size() - 1);
  const double knots_per_second = timed ? last / motion.duration : 0;

  PointCloud<float> corrected;
  corrected.time_offsets = sweep.time_offsets;
  corrected.intensities = sweep.intensities;
  corrected.positions.resize(sweep.size());
  executor.for_chunks(to_index(sweep.size()), grain, [&](Index begin, Index end) {
    for (auto i = static_cast<std::size_t>(begin); i < static_cast<std::size_t>(end); ++i) {
      const Eigen::Vector3d p = converted<double>(sweep.positions[i]);
      if (!timed) {
        corrected.positions[i] = converted<float>(sum_of(product(knots.back().R, p), knots.back().t));
        continue;
      }
      const double wanted = sweep.time_offsets[i] * knots_per_second;
      const double place = wanted > 0 ? std::min(wanted, last) : 0.0;  // NaN counts as the sweep's begin
      const auto k = std::min(static_cast<std::size_t>(place), knots.size() - 2);
      const double share = place - static_cast<double>(k);
      const Eigen::Vector3d before = sum_of(product(knots[k].R, p), knots[k].t);
      const Eigen::Vector3d after = sum_of(product(knots[k + 1].R, p), knots[k + 1].t);
      const Eigen::Vector3d moved = sum_of(before, scaled(share, difference_of(after, before)));
      corrected.positions[i] = converted<float>(moved);
    }
  });
  return corrected;
}

}  // namespace chainslam
