#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/slam/back_end.hpp"
#include "graph/attempts.hpp"
#include "graph/drawn_session.hpp"
#include "graph/sampled_closer.hpp"
#include "graph/sampled_drives.hpp"
#include "graph/town.hpp"
#include "mapper/presets.hpp"

namespace chainslam::experiments {

using GraphBackEnd = BackEnd<SampledCloser, ChainedCloser, SampledMerger>;

/// What was measured on recordings and on the map of them.
struct Measured {
  std::vector<MeasuredDrive> drives;
  std::vector<std::vector<Vector6d>> errors;  ///< of each drive's steps
  Attempts attempts;
};

/// A world that is drawn session by session: odometry errs as measured, accelerometer and GNSS have measured what is
/// recorded, the back end that the settings describe maps it.
class DrawnWorld {
 public:
  /// @param visits  the sessions, in their order.
  DrawnWorld(std::uint64_t seed, const Measured& measured, const mapper::BackEndParts& parts, std::vector<Visit> visits)
      : rng_(seed),
        measured_(measured),
        visits_(std::move(visits)),
        R_ecef_truth_(R_ecef_truth(measured.drives)),
        scans_(scans(rng_, measured, visits_)),
        back_end_(parts.back_end, SampledCloser(scans_, parts.closures, parts.candidates), ChainedCloser(parts.chain),
                  SampledMerger(scans_, parts.merge, parts.gnss.radius), parts.outliers) {}

  /// Maps the next session. @returns milliseconds of each keyframe.
  std::vector<double> drive() {
    const Visit& visit = visits_[session_];
    const MeasuredDrive drive = moved(measured_.drives[visit.drive], visit.offset, R_ecef_truth_);
    const DrawnOdometry drawn = drawn_odometry(drive.truth, measured_.errors, rng_.fork(2).fork(session_));
    return map_session(back_end_, drive, drawn, "session " + std::to_string(++session_));
  }

  GraphBackEnd& back_end() { return back_end_; }
  [[nodiscard]] const SampledScans& scans() const { return *scans_; }

 private:
  static std::shared_ptr<SampledScans> scans(const Rng& rng, const Measured& measured,
                                             const std::vector<Visit>& visits) {
    auto scans = std::make_shared<SampledScans>();
    scans->attempts = measured.attempts;
    scans->rng = rng.fork(1);
    for (const Visit& visit : visits)
      for (const SE3d& pose : measured.drives[visit.drive].truth.poses)
        scans->add(SE3d(pose.rotation(), pose.translation() + visit.offset));
    return scans;
  }

  Rng rng_;
  const Measured& measured_;
  std::vector<Visit> visits_;
  std::optional<Eigen::Matrix3d> R_ecef_truth_;
  std::shared_ptr<SampledScans> scans_;
  GraphBackEnd back_end_;
  std::size_t session_ = 0;
};

}  // namespace chainslam::experiments
