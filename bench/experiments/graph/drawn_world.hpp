#pragma once

#include <cstddef>
#include <memory>
#include <string>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/slam/back_end.hpp"
#include "graph/attempts.hpp"
#include "graph/drawn_session.hpp"
#include "graph/sampled_closer.hpp"
#include "graph/sampled_drives.hpp"
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
  /// @param sessions  as many, which drive the measured paths in turn.
  DrawnWorld(std::uint64_t seed, const Measured& measured, const mapper::BackEndParts& parts, std::size_t sessions)
      : rng_(seed),
        measured_(measured),
        scans_(scans(rng_, measured, sessions)),
        back_end_(parts.back_end, SampledCloser(scans_, parts.closures, parts.candidates), ChainedCloser(parts.chain),
                  SampledMerger(scans_, parts.merge, parts.gnss.radius), parts.outliers) {}

  /// Maps the next session. @returns milliseconds of each keyframe.
  std::vector<double> drive() {
    const MeasuredDrive& drive = measured_.drives[session_ % measured_.drives.size()];
    const DrawnOdometry drawn = drawn_odometry(drive.truth, measured_.errors, rng_.fork(2).fork(session_));
    return map_session(back_end_, drive, drawn, "session " + std::to_string(++session_));
  }

  GraphBackEnd& back_end() { return back_end_; }
  [[nodiscard]] const SampledScans& scans() const { return *scans_; }

 private:
  static std::shared_ptr<SampledScans> scans(const Rng& rng, const Measured& measured, std::size_t sessions) {
    auto scans = std::make_shared<SampledScans>();
    scans->attempts = measured.attempts;
    scans->rng = rng.fork(1);
    for (std::size_t i = 0; i < sessions; ++i) {
      const std::vector<SE3d>& poses = measured.drives[i % measured.drives.size()].truth.poses;
      scans->truth.insert(scans->truth.end(), poses.begin(), poses.end());
    }
    return scans;
  }

  Rng rng_;
  const Measured& measured_;
  std::shared_ptr<SampledScans> scans_;
  GraphBackEnd back_end_;
  std::size_t session_ = 0;
};

}  // namespace chainslam::experiments
