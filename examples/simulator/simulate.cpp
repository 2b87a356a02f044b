#include "simulator/simulate.hpp"

#include <chrono>
#include <cstdio>
#include <optional>
#include <string>
#include <vector>

#include "chainslam/io/trajectory_file.hpp"
#include "simulator/nclt_files.hpp"
#include "simulator/new_folder.hpp"
#include "simulator/nuscenes_files.hpp"
#include "simulator/preset_description.hpp"
#include "simulator/rig.hpp"
#include "simulator/scan_batches.hpp"
#include "simulator/town_drive.hpp"

namespace chainslam::simulator {

namespace {

namespace fs = std::filesystem;

/// @param labels  where to write the presence of every hit, if anywhere.
std::uint64_t write_hits(const fs::path& path, const fs::path& labels, const TownDrive& drive,
                         const ChunkRunner& run_chunks, const std::function<void(Index)>& made) {
  HitsFile file(path);
  std::optional<AtomicFile> presences;
  if (!labels.empty()) presences.emplace(labels);
  const auto encode = [&](const Revolution& turn) { return HitsFile::encode(turn, drive.lidar(), drive.epoch()); };
  const auto take = [&](Index, const EncodedScan& scan) {
    file.write(scan.bytes);
    if (!presences) return;
    std::string of_scan;
    for (const LidarReturn& hit : scan.revolution.returns) of_scan += static_cast<char>(hit.presence);
    presences->write(of_scan);
  };
  const std::uint64_t points = for_each_scan(drive, run_chunks, encode, take, made);
  file.commit();
  if (presences) presences->commit();
  return points;
}

std::string describe(const SE3d& T) {
  const auto& q = T.rotation().quaternion();
  std::string text(160, '\0');
  const int size = std::snprintf(text.data(), text.size(), "%.6f %.6f %.6f  %.9f %.9f %.9f %.9f", T.translation().x(),
                                 T.translation().y(), T.translation().z(), q.x(), q.y(), q.z(), q.w());
  text.resize(static_cast<std::size_t>(size));
  return text;
}

/// As NCLT names its sessions, such as 2013-06-01.
std::string date_of(Timestamp time) {
  const std::chrono::sys_time<Duration> instant(Duration(time.nanoseconds()));
  const std::chrono::year_month_day date(std::chrono::floor<std::chrono::days>(instant));
  const auto two_digits = [](unsigned value) { return (value < 10 ? "-0" : "-") + std::to_string(value); };
  return std::to_string(static_cast<int>(date.year())) + two_digits(static_cast<unsigned>(date.month())) +
         two_digits(static_cast<unsigned>(date.day()));
}

std::string heading(const Preset& preset, std::uint64_t seed) {
  return preset.summary + ".\n\npreset: " + preset.name + "\nseed: " + std::to_string(seed) +
         "\noptions: " + options_hash(preset) + "\n";
}

/// How long, how far and how much.
std::string figures(const TownDrive& drive, std::uint64_t points) {
  return "scans: " + std::to_string(drive.scan_count()) + " at 10 Hz\npoints: " + std::to_string(points) +
         "\nduration: " + std::to_string(drive.drive().duration()) +
         " s\nlength: " + std::to_string(drive.drive().length()) + " m\n\n";
}

constexpr const char* about_errors =
    "The sensors differ from what is stated here, as real ones do: per-laser elevation and range, extrinsic "
    "calibration, scale, bias.\n";
constexpr const char* about_truth =
    "t x y z qx qy qz qw, the pose of the IMU at the end of every\nscan; map frame x north, y west, z up, "
    "body "
    "frame x ahead, y left, z up.\n";

void write_readme(const fs::path& path, const Preset& preset, std::uint64_t seed, std::size_t session,
                  const TownDrive& drive, std::uint64_t points) {
  AtomicFile file(path);
  file.write("A simulated LiDAR session in NCLT's file layout: " + heading(preset, seed));
  if (preset.sessions.size() > 1)
    file.write("session: " + std::to_string(session + 1) + " of " + std::to_string(preset.sessions.size()) +
               ", all in one map frame\n");
  file.write(figures(drive, points));
  file.write("velodyne_hits.bin, ms25.csv, gps.csv and groundtruth_" + date_of(drive.epoch()) + ".csv");
  file.write(
      " are laid out as NCLT has them (axes z down;\n"
      "the ground truth is that of the robot's base). truth.tum: " +
      std::string(about_truth) + "\n" + about_errors +
      "Nominal pose of the LiDAR in the body frame, both z up (x y z  qx qy qz qw):\n  " +
      describe(preset.lidar.T_body_lidar) + "\n");
  if (preset.labelled)
    file.write(
        "labels.bin: a byte for every hit in velodyne_hits.bin, 0 lasting, 1 not there on all days, 2 moving.\n");
  file.commit();
}

/// A session as a folder of its own, or as the whole folder if it is the only one.
std::uint64_t write_nclt(NewFolder& folder, const Preset& preset, std::uint64_t seed, std::size_t session,
                         const TownDrive& drive, const ChunkRunner& run_chunks,
                         const std::function<void(Index)>& made) {
  const fs::path place = preset.sessions.size() > 1 ? "session" + std::to_string(session + 1) : "";
  if (!place.empty()) fs::create_directory(folder.part(place));
  const fs::path hits = folder.part(place / "velodyne_hits.bin");
  const fs::path labels = preset.labelled ? folder.part(place / "labels.bin") : fs::path();
  const std::uint64_t points = write_hits(hits, labels, drive, run_chunks, made);
  write_ms25(folder.part(place / "ms25.csv"), drive);
  write_gps(folder.part(place / "gps.csv"), drive);
  write_ground_truth(folder.part(place / ("groundtruth_" + date_of(drive.epoch()) + ".csv")), drive);
  write_tum(folder.part(place / "truth.tum"), drive.truth_at_scan_ends());
  write_readme(folder.part(place / "README.txt"), preset, seed, session, drive, points);
  return points;
}

/// A session as a scene; its truth beside the tables.
std::uint64_t write_scene(NewFolder& folder, NuscenesFolder& tables, std::size_t session, const TownDrive& drive,
                          const ChunkRunner& run_chunks, const std::function<void(Index)>& made) {
  tables.begin_scene(session, drive);
  const auto encode = [&](const Revolution& turn) { return NuscenesFolder::encode(turn, drive.lidar()); };
  const auto take = [&](Index index, const EncodedScan& scan) { tables.add_scan(index, scan.revolution, scan.bytes); };
  const std::uint64_t points = for_each_scan(drive, run_chunks, encode, take, made);
  write_tum(folder.part("truth_session" + std::to_string(session + 1) + ".tum"), drive.truth_at_scan_ends());
  return points;
}

}  // namespace

SimulationReport simulate(const Preset& preset, std::uint64_t seed, const fs::path& directory,
                          const ChunkRunner& run_chunks, const SimulationProgress& progress) {
  NewFolder folder(directory);
  std::vector<TownDrive> drives;
  SimulationReport report;
  for (std::size_t i = 0; i < preset.sessions.size(); ++i) {
    const TownDrive& drive = drives.emplace_back(preset, seed, i);
    report.scans += drive.scan_count();
    report.duration += drive.drive().duration();
    report.length += drive.drive().length();
  }
  Index done = 0;
  const auto made = [&](Index scans) {
    done += scans;
    if (progress) progress(done, report.scans);
  };
  std::optional<NuscenesFolder> tables;
  std::string readme;
  if (preset.layout == FileLayout::nuscenes) {
    tables.emplace(directory, preset, folder.parts());
    readme = "Simulated LiDAR sessions in nuScenes' tables, as MARS has them: " + heading(preset, seed);
  }
  for (std::size_t i = 0; i < drives.size(); ++i) {
    const TownDrive& drive = drives[i];
    const std::uint64_t points = tables ? write_scene(folder, *tables, i, drive, run_chunks, made)
                                        : write_nclt(folder, preset, seed, i, drive, run_chunks, made);
    if (tables) readme += "\nscene session" + std::to_string(i + 1) + "\n" + figures(drive, points);
    report.points += points;
  }
  if (tables) {
    tables->finish();
    AtomicFile file(folder.part("README.txt"));
    file.write(readme + "truth_session*.tum: " + about_truth + about_errors);
    file.commit();
  }
  report.bytes = folder.keep();
  return report;
}

}  // namespace chainslam::simulator
