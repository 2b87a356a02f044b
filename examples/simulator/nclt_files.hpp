#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "chainslam/io/atomic_file.hpp"
#include "simulator/town_drive.hpp"

namespace chainslam::simulator {

/// NCLT's `velodyne_hits.bin`, written revolution by revolution.
///
/// Packets, little endian: 4 x u16 44444, u32 hits, u64 microseconds of the first firing, 4 bytes of padding, then for
/// each hit u16 x, y, z (metres = value * 0.005 - 100; Velodyne frame, z down), u8 intensity, u8 laser. A packet holds
/// the hits of 12 firings, up to 384.
class HitsFile {
 public:
  /// @throws IoError if the file cannot be made.
  explicit HitsFile(const std::filesystem::path& path) : file_(path) {}

  /// Turns a revolution into bytes; needs no file, so that threads can share the work.
  [[nodiscard]] static std::vector<std::byte> encode(const Revolution& revolution, const SpinningLidar& lidar,
                                                     Timestamp epoch);

  /// Appends encoded revolutions, in the order of time. @throws IoError when the disk does not take them.
  void write(std::span<const std::byte> packets) { file_.write(packets); }
  /// Gives the file its name. @throws IoError
  void commit() { file_.commit(); }

 private:
  AtomicFile file_;
};

/// NCLT's `ms25.csv`: microseconds, magnetic field (gauss), specific force (m/s^2), rates (rad/s); axes x ahead, y
/// right, z down; no header. @throws IoError
void write_ms25(const std::filesystem::path& path, const TownDrive& drive);

/// NCLT's `gps.csv`: microseconds, mode, satellites, latitude and longitude (rad), altitude (m, NaN without a fix),
/// track (rad), speed (m/s). @throws IoError
void write_gps(const std::filesystem::path& path, const TownDrive& drive);

/// NCLT's `groundtruth_<date>.csv`: microseconds, x north, y east, z down (metres), roll, pitch, heading (rad) of the
/// robot's base, every 50 ms, at times of its own. @throws IoError
void write_ground_truth(const std::filesystem::path& path, const TownDrive& drive);

}  // namespace chainslam::simulator
