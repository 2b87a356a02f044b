#pragma once

#include <memory>
#include <optional>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/odometry/odometry_source.hpp"
#include "chainslam/sensor/frame.hpp"
#include "chainslam/sensor/imu_check.hpp"
#include "chainslam/sensor/packet.hpp"
#include "datasets/dataset.hpp"
#include "options.hpp"
#include "support/imu_calibration.hpp"

namespace chainslam::mapper {

/// The odometry of one session, of whichever source the settings name.
class SessionOdometry {
 public:
  SessionOdometry() = default;
  SessionOdometry(const SessionOdometry&) = delete;
  SessionOdometry& operator=(const SessionOdometry&) = delete;
  virtual ~SessionOdometry() = default;

  /// Takes the next packet, in time order. @returns the next frame, if one is complete.
  [[nodiscard]] virtual std::optional<Frame> process(const Packet& packet, const ThreadPool& threads) = 0;
  /// After the last packet: frames that still wait, one a call, then nothing.
  [[nodiscard]] virtual std::optional<Frame> flush(const ThreadPool& threads) = 0;
  [[nodiscard]] virtual LidarOdometryCounts counts() const = 0;
  /// What was found of the IMU's clock and axes; nothing if they are taken as given.
  [[nodiscard]] virtual std::optional<support::ImuCalibration> calibration() const { return std::nullopt; }
};

[[nodiscard]] std::unique_ptr<SessionOdometry> make_session_odometry(const MapperOptions& options,
                                                                     const datasets::DatasetInfo& dataset);

/// @name How a data set's IMU is checked and compared with the scans.
/// @{

/// Units that the settings state are the reader's affair: what it gives is in m/s^2 and rad/s.
[[nodiscard]] ImuCheckOptions imu_check_of(const datasets::DatasetOptions& dataset);
/// A rotation that nothing states is not held against the data.
[[nodiscard]] ImuAlignmentOptions alignment_options(const datasets::DatasetInfo& dataset);
[[nodiscard]] support::ImuCalibration given_calibration(const datasets::DatasetOptions& options,
                                                        const datasets::DatasetInfo& dataset);
/// @}

}  // namespace chainslam::mapper
