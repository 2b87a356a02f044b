#pragma once

#include <array>
#include <cstddef>
#include <filesystem>
#include <string>
#include <vector>

#include "simulator/town_drive.hpp"

namespace chainslam::simulator {

/// A data set in nuScenes' tables as MARS has them: one object, a scene for each session.
///
/// `v1.0/*.json` are the tables; `sweeps/LIDAR_FRONT_CENTER/<utime>.pcd.bin` one revolution each: float32 x, y, z,
/// intensity (0 to 255), ring, little endian, in the sensor's frame as recorded, without times; `utime` is the
/// revolution's end. `sweeps/IMU_TOP/<utime>.json`: utime, position (lat and lon in degrees, elev in metres; left out
/// where there is no fix, elev also where a fix has none), vel (east, north, up, m/s, of the receiver), avel (rad/s)
/// and acc (m/s^2, gravity included). `ego_pose` holds the truth at each sample, T_map_ego. If the preset is labelled:
/// `lidarseg/v1.0/<sample_data>_lidarseg.bin`, a byte a point: 0 lasting, 1 changing, 2 moving.
class NuscenesFolder {
 public:
  /// @param root  exists; files are made in it. `made` lists all that is made, folders first.
  NuscenesFolder(const std::filesystem::path& root, const Preset& preset, std::vector<std::filesystem::path>& made);

  /// Begins a session's scene and writes all that is no scan. @throws IoError
  void begin_scene(std::size_t session, const TownDrive& drive);
  /// The points of a revolution as a file's bytes; needs no folder, so that threads can share the work.
  [[nodiscard]] static std::vector<std::byte> encode(const Revolution& revolution, const SpinningLidar& lidar);
  /// Writes a revolution of the scene; in order. @throws IoError
  void add_scan(Index index, const Revolution& revolution, std::span<const std::byte> bytes);
  /// Writes the tables. @throws IoError
  void finish();

 private:
  enum Table { log, sensor, calibrated_sensor, scene, sample, sample_data, ego_pose, category, lidarseg, tables };

  void add_row(Table table, const std::string& row);
  void add_rig(const Preset& preset);
  void write_imu();
  void write_file(const std::filesystem::path& name, std::span<const std::byte> bytes);
  [[nodiscard]] Timestamp sample_time(Index index) const { return drive_->scan_end(index); }
  /// The next scan from here on, forwards (1) or backwards (-1), that arrives; out of range if there is none.
  [[nodiscard]] Index arriving(Index from, Index direction) const;
  void add_sample_data(Table kind, Index index, Index sample_index, Index count, Timestamp time, bool key,
                       const std::string& name);

  std::filesystem::path root_;
  std::vector<std::filesystem::path>& made_;
  const TownDrive* drive_ = nullptr;  ///< of the scene that is being written
  std::size_t session_ = 0;
  bool labelled_;
  std::array<std::string, tables> rows_;
};

}  // namespace chainslam::simulator
