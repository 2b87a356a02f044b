#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "chainslam/io/input_file.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/sensor/packet.hpp"
#include "chainslam/trajectory/trajectory.hpp"

namespace chainslam::datasets {

/// A packet of velodyne_hits.bin: up to 384 hits with one time.
struct NcltPacket {
  Timestamp time;
  std::vector<Eigen::Vector3f> positions;  ///< metres, as recorded: x forward, y right, z down
  std::vector<float> intensities;
};

/// Reads a packet, or nothing at the end of the file. @throws IoError naming the byte if the file is damaged or cut.
[[nodiscard]] std::optional<NcltPacket> read_nclt_packet(InputFile& file);

/// Cuts packets into sweeps where the azimuth wraps, behind the sensor (x < 0), whichever way it turns.
///
/// A sweep that covers less than half a turn (the recording's first and last) is dropped and counted. A pause of more
/// than 0.2 s ends a sweep too, and so does one of more than 1 s or 2^20 points, which does not turn. Where the file is
/// damaged or was cut, the sweeps end. Points of a packet are spread evenly over the time until the next packet; over
/// the last such time where there is none, or a pause.
class NcltSweeps {
 public:
  /// @throws IoError if the file cannot be read, or not even its first packet.
  explicit NcltSweeps(const std::filesystem::path& path) : file_(path), packet_(read_nclt_packet(file_)) {}

  /// The next sweep, axes as recorded.
  [[nodiscard]] std::optional<LidarScan> next();

  [[nodiscard]] std::size_t dropped() const { return dropped_; }    ///< sweeps of less than half a turn
  [[nodiscard]] std::size_t backward() const { return backward_; }  ///< packets earlier than the one before
  /// Where and why the packets end before the file does; empty if they do not.
  [[nodiscard]] const std::string& damage() const { return damage_; }
  [[nodiscard]] const std::optional<NcltPacket>& ahead() const { return packet_; }

 private:
  void read_ahead();
  void take(LidarScan& sweep);
  [[nodiscard]] bool ends_here(const LidarScan& sweep, Timestamp last);

  InputFile file_;
  std::optional<NcltPacket> packet_;                    ///< not yet in a sweep
  Duration interval_ = std::chrono::microseconds(553);  ///< HDL-32E: 12 firings of 46.08 us
  double azimuth_ = 0;    ///< of the last packet, unwrapped, in turns; 0 behind the sensor
  double started_ = 0;    ///< of the sweep's first packet
  bool turning_ = false;  ///< whether `azimuth_` is known
  std::size_t dropped_ = 0;
  std::size_t backward_ = 0;
  std::string damage_;
};

/// Reads a file of velodyne_sync: points of 8 bytes without a header, axes as recorded.
[[nodiscard]] PointCloud<float> read_nclt_sync(const std::filesystem::path& path);

/// Reads a groundtruth csv: utime, x (north), y (east), z (down), roll, pitch, heading of NCLT's body. Rows with NaN
/// are left out. @returns T_map_body with our axes: map x north, y west, z up; body = the inertial unit, x forward, y
/// left, z up.
/// @throws IoError naming the place of what is no number, or of a row that goes back in time.
[[nodiscard]] Trajectory read_nclt_ground_truth(const std::filesystem::path& path);

/// NCLT's own mounting: T_body_velodyne and T_body_imu with body x forward, y right, z down.
[[nodiscard]] SE3d nclt_T_body_velodyne();
[[nodiscard]] SE3d nclt_T_body_imu();

/// From x forward, y right, z down to x forward, y left, z up, and back: half a turn about x.
[[nodiscard]] SE3d half_turn_about_x();

}  // namespace chainslam::datasets
