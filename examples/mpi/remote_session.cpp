#include "remote_session.hpp"

#include <utility>

#include "datasets/odometry_recording.hpp"

namespace chainslam::mpi {

RemoteSession::RemoteSession(std::unique_ptr<datasets::Dataset> data, const datasets::DatasetOptions& options,
                             const KeyframeOptions& keyframes, std::function<std::optional<Recorded>()> await)
    : data_(std::move(data)), options_(options), await_(std::move(await)) {
  info_ = data_->info();
  info_.has_odometry = info_.motion_corrected = true;
  info_.keyframes = keyframes;
}

void RemoteSession::open() {
  opened_ = true;
  std::optional<Recorded> recorded = await_();
  if (!recorded) return;
  if (recorded->result.frames > 0) recording_ = datasets::open_recorded_odometry(recorded->set, options_);
  info_.warnings = recorded->result.warnings;
  result_ = std::move(recorded->result);
}

std::optional<Frame> RemoteSession::next_frame() {
  if (!opened_) open();
  std::optional<Frame> frame = recording_ ? recording_->next_frame() : std::nullopt;
  if (!frame && result_ && result_->run.failure) throw IoError(*result_->run.failure);
  return frame;
}

std::vector<GnssFix> RemoteSession::take_fixes() {
  return recording_ ? recording_->take_fixes() : std::vector<GnssFix>();
}

}  // namespace chainslam::mpi
