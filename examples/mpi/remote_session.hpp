#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "datasets/dataset.hpp"
#include "session_task.hpp"

namespace chainslam::mpi {

/// A data set whose odometry another process records: reading it waits for that, and gives the recording's frames.
/// Data that could not be read to their end fail there again, as they would have here.
class RemoteSession final : public datasets::Dataset {
 public:
  struct Recorded {
    std::filesystem::path set;
    SessionResult result;
  };

  /// @param data     as it is without odometry
  /// @param options  that its recording is opened with
  /// @param keyframes  that are recorded of it
  /// @param await    waits for the recording; gives nothing if the run is to stop. @throws IoError if there is none
  RemoteSession(std::unique_ptr<datasets::Dataset> data, const datasets::DatasetOptions& options,
                const KeyframeOptions& keyframes, std::function<std::optional<Recorded>()> await);

  std::optional<Packet> next() override { return std::nullopt; }
  std::optional<Frame> next_frame() override;
  std::vector<GnssFix> take_fixes() override;
  [[nodiscard]] std::optional<Trajectory> truth() const override { return data_->truth(); }
  /// What is known of it once it was read.
  [[nodiscard]] const std::optional<SessionResult>& result() const { return result_; }

 private:
  void open();

  std::unique_ptr<datasets::Dataset> data_, recording_;
  datasets::DatasetOptions options_;
  std::function<std::optional<Recorded>()> await_;
  bool opened_ = false;
  std::optional<SessionResult> result_;
};

}  // namespace chainslam::mpi
