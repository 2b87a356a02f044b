#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/evaluation/kitti_errors.hpp"
#include "chainslam/odometry/lidar_inertial_odometry.hpp"
#include "chainslam/odometry/lidar_odometry.hpp"
#include "chainslam/odometry/self_calibrating.hpp"
#include "chainslam/search/ikd_tree.hpp"
#include "support/drive_run.hpp"

namespace chainslam::bench {

/// The odometries that `odometry.source` chooses from, with the settings that users get.
/// @{
struct LidarSource {
  using Odometry = LidarOdometry<>;
  static Odometry::Options options() { return {}; }
};
struct FastLio2Source {
  using Odometry = LidarInertialOdometry<IkdTree<float, NearestToCenter>, Trivial>;
  static Odometry::Options options() { return fast_lio2_options(); }
};
struct LidarInertialSource {
  using Odometry = SelfCalibrating<LidarInertialOdometry<>>;
  static Odometry::Options options() { return {}; }
};
/// @}

/// What an odometry came to on a drive; what is not known stays empty.
struct Outcome {
  std::optional<double> ape{};    ///< metres, rms, aligned by a rotation and a translation
  std::optional<double> kitti{};  ///< percent
  double path = 0;                ///< metres, steps below 0.05 m left out, in which noise would add up at a stop
  std::int64_t lost = 0;          ///< scans lost, or without a frame
  double milliseconds = 0;        ///< per scan
  bool finite = true;             ///< every pose
};

[[nodiscard]] inline double travelled(const Trajectory& trajectory) {
  double length = 0;
  if (trajectory.empty()) return length;
  Eigen::Vector3d last = trajectory.poses.front().translation();
  for (const SE3d& pose : trajectory.poses) {
    const double step = (pose.translation() - last).norm();
    if (step < 0.05) continue;
    length += step;
    last = pose.translation();
  }
  return length;
}

/// @param drive  its reference, where there is one.
[[nodiscard]] inline Outcome outcome_of(const test::Drive& drive, const test::DriveRun& run) {
  const LidarOdometryCounts& counts = run.counts;
  Outcome outcome{.path = travelled(run.lidar),
                  .lost = counts.lost_scans + counts.scans - counts.frames,
                  .milliseconds = 1e3 * run.seconds_per_scan,
                  .finite = !first_not_finite(run.lidar.poses)};
  if (!outcome.finite || drive.reference.empty()) return outcome;
  const MatchedTrajectories poses = test::counted_poses(drive, run.lidar);
  const AbsolutePoseErrors absolute = ape(poses.reference, poses.estimate);
  if (absolute.status == EvaluationStatus::evaluated) outcome.ape = absolute.translation.rmse;
  const KittiErrors relative = kitti_errors(poses.reference, poses.estimate);
  if (relative.status == EvaluationStatus::evaluated) outcome.kitti = 100 * relative.translation;
  return outcome;
}

/// A Markdown table: a row for each drive and variant of it, a column for each odometry.
class DriveTable {
 public:
  explicit DriveTable(std::string title) : title_(std::move(title)) {}

  /// Runs all odometries. @param run  makes an `Outcome` of one of the sources above.
  template <class Run>
  void add(const std::string& drive, const std::string& variant, const Run& run) {
    Row row{drive, variant, {run(LidarSource{}), run(FastLio2Source{}), run(LidarInertialSource{})}};
    std::fputs(line(row).c_str(), stderr);  // as it comes: the whole takes minutes
    rows_.push_back(std::move(row));
  }

  /// @param with_mean  adds a row with the mean of the relative errors.
  [[nodiscard]] std::string markdown(bool with_mean = false) const {
    if (rows_.empty()) return {};
    std::string text = "## " + title_ + "\n\n| drive | variant | `lidar` | `fast_lio2` | `lidar_inertial` |\n" +
                       "|---|---|---|---|---|\n";
    for (const Row& row : rows_) text += line(row);
    if (with_mean) text += mean_line();
    return text + '\n';
  }

 private:
  struct Row {
    std::string drive, variant;
    std::array<Outcome, 3> outcomes;
  };

  [[nodiscard]] static std::string line(const Row& row) {
    std::string text = "| " + row.drive + " | " + row.variant + " |";
    for (const Outcome& outcome : row.outcomes) text += ' ' + cell(outcome) + " |";
    return text + '\n';
  }

  /// With so many decimals, but what is absurdly large with three digits.
  [[nodiscard]] static std::string number(double value, int decimals) {
    char text[64];
    std::snprintf(text, sizeof text, value < 1e4 ? "%.*f" : "%.*g", value < 1e4 ? decimals : 3, value);
    return text;
  }

  [[nodiscard]] static std::string cell(const Outcome& outcome) {
    std::string text = "poses not finite";
    if (outcome.ape)
      text = number(*outcome.ape, 3) + " m";
    else if (outcome.finite)
      text = "path " + number(outcome.path, 1) + " m";
    if (outcome.kitti) text += ", " + number(*outcome.kitti, 2) + " %";
    if (outcome.lost > 0) text += ", **" + std::to_string(outcome.lost) + " lost**";
    return text + ", " + number(outcome.milliseconds, 1) + " ms";
  }

  [[nodiscard]] std::string mean_line() const {
    std::string text = "| mean | |";
    for (std::size_t i = 0; i < 3; ++i) {
      double sum = 0;
      int count = 0;
      for (const Row& row : rows_)
        if (const auto& kitti = row.outcomes[i].kitti) {
          sum += *kitti;
          ++count;
        }
      text += count > 0 ? ' ' + number(sum / count, 2) + " % |" : " – |";
    }
    return text + '\n';
  }

  std::string title_;
  std::vector<Row> rows_;
};

}  // namespace chainslam::bench
