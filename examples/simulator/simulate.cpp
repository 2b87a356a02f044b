#include "simulator/simulate.hpp"

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <string>
#include <vector>

#include "chainslam/io/tum.hpp"
#include "simulator/nclt_files.hpp"
#include "simulator/rig.hpp"
#include "simulator/town_drive.hpp"

namespace chainslam::simulator {

namespace {

namespace fs = std::filesystem;

/// A folder that was empty: what has been finished in it goes again unless all was.
class NewFolder {
 public:
  explicit NewFolder(const fs::path& path) : path_(path) {
    std::error_code error;
    fs::create_directories(path, error);
    if (error) throw_output_error(path.string(), "", error.message(), "choose a folder that can be made");
    if (!fs::is_empty(path, error) || error)
      throw_output_error(path.string(), "", error ? error.message() : "a folder that is not empty",
                         "name a new or empty folder; nothing in it was changed");
  }
  NewFolder(const NewFolder&) = delete;
  NewFolder& operator=(const NewFolder&) = delete;
  ~NewFolder() {
    if (whole_) return;
    std::error_code ignored;
    for (; !parts_.empty(); parts_.pop_back()) fs::remove(parts_.back(), ignored);
  }

  /// A file or folder to be made in it.
  const fs::path& part(const fs::path& name) { return parts_.emplace_back(path_ / name); }

  /// Bytes in all files, which stay from now on.
  std::uint64_t keep() {
    whole_ = true;
    std::uint64_t bytes = 0;
    for (const fs::path& part : parts_) bytes += fs::is_regular_file(part) ? fs::file_size(part) : 0;
    return bytes;
  }

 private:
  fs::path path_;
  std::vector<fs::path> parts_;  ///< folders before what is in them
  bool whole_ = false;
};

/// @param made  called with the scans that have been written since the last call.
std::uint64_t write_hits(const fs::path& path, const TownDrive& drive, const ChunkRunner& run_chunks,
                         const std::function<void(Index)>& made) {
  constexpr Index batch = 32;  // scans that are made, then written together
  HitsFile file(path);
  std::uint64_t points = 0;
  for (Index done = 0; done < drive.scan_count();) {
    const Index count = std::min(batch, drive.scan_count() - done);
    std::vector<std::vector<std::byte>> encoded(static_cast<std::size_t>(count));
    std::vector<std::size_t> returns(encoded.size());
    run_chunks(count, 1, [&](Index begin, Index end) {
      for (Index i = begin; i < end; ++i) {
        const Revolution revolution = drive.revolution(done + i);
        returns[static_cast<std::size_t>(i)] = revolution.returns.size();
        encoded[static_cast<std::size_t>(i)] = HitsFile::encode(revolution, drive.lidar(), drive.epoch());
      }
    });
    for (const auto& packets : encoded) file.write(packets);
    for (const std::size_t in_scan : returns) points += in_scan;
    done += count;
    made(count);
  }
  file.commit();
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

void write_readme(const fs::path& path, const Preset& preset, std::uint64_t seed, std::size_t session,
                  const TownDrive& drive, std::uint64_t points) {
  AtomicFile file(path);
  file.write("A simulated LiDAR session in NCLT's file layout: " + preset.summary + ".\n\n");
  file.write("preset: " + preset.name + "\nseed: " + std::to_string(seed) + "\n");
  if (preset.sessions.size() > 1)
    file.write("session: " + std::to_string(session + 1) + " of " + std::to_string(preset.sessions.size()) +
               ", all in one map frame\n");
  file.write("scans: " + std::to_string(drive.scan_count()) + " at 10 Hz\npoints: " + std::to_string(points) + "\n");
  file.write("duration: " + std::to_string(drive.drive().duration()) +
             " s\nlength: " + std::to_string(drive.drive().length()) + " m\n\n");
  file.write("velodyne_hits.bin, ms25.csv, gps.csv and groundtruth_" + date_of(drive.epoch()) + ".csv");
  file.write(
      " are laid out as NCLT has them (axes z down;\n"
      "the ground truth is that of the robot's base). truth.tum: t x y z qx qy qz qw, the pose of the inertial unit at "
      "the\n"
      "end of every scan; map frame x north, y west, z up, body frame x ahead, y left, z up.\n\n"
      "The sensors are off what is stated here, as real ones are: per-laser elevation and range, mounting, scale, "
      "bias.\n"
      "Nominal pose of the LiDAR in the body frame, both z up (x y z  qx qy qz qw):\n  " +
      describe(nominal_T_body_lidar()) + "\n");
  file.commit();
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
  for (std::size_t i = 0; i < drives.size(); ++i) {
    const TownDrive& drive = drives[i];
    const fs::path place = drives.size() > 1 ? "session" + std::to_string(i + 1) : "";
    if (!place.empty()) fs::create_directory(folder.part(place));
    const std::uint64_t points = write_hits(folder.part(place / "velodyne_hits.bin"), drive, run_chunks, made);
    write_ms25(folder.part(place / "ms25.csv"), drive);
    write_gps(folder.part(place / "gps.csv"), drive);
    write_ground_truth(folder.part(place / ("groundtruth_" + date_of(drive.epoch()) + ".csv")), drive);
    write_tum(folder.part(place / "truth.tum"), drive.truth_at_scan_ends());
    write_readme(folder.part(place / "README.txt"), preset, seed, i, drive, points);
    report.points += points;
  }
  report.bytes = folder.keep();
  return report;
}

}  // namespace chainslam::simulator
