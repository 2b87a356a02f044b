#include "simulator/simulate.hpp"

#include <algorithm>
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
    for (const fs::path& name : names_) fs::remove(path_ / name, ignored);
  }

  fs::path file(const char* name) {
    names_.emplace_back(name);
    return path_ / name;
  }

  /// Bytes in all files, which stay from now on.
  std::uint64_t keep() {
    whole_ = true;
    std::uint64_t bytes = 0;
    for (const fs::path& name : names_) bytes += fs::file_size(path_ / name);
    return bytes;
  }

 private:
  fs::path path_;
  std::vector<fs::path> names_;
  bool whole_ = false;
};

std::uint64_t write_hits(const fs::path& path, const TownDrive& drive, const ChunkRunner& run_chunks,
                         const SimulationProgress& progress) {
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
        encoded[static_cast<std::size_t>(i)] = HitsFile::encode(revolution, drive.lidar(), TownDrive::epoch());
      }
    });
    for (const auto& packets : encoded) file.write(packets);
    for (const std::size_t in_scan : returns) points += in_scan;
    done += count;
    if (progress) progress(done, drive.scan_count());
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

void write_readme(const fs::path& path, const Preset& preset, std::uint64_t seed, const SimulationReport& report) {
  AtomicFile file(path);
  file.write("A simulated LiDAR session in NCLT's file layout: " + preset.summary + ".\n\n");
  file.write("preset: " + preset.name + "\nseed: " + std::to_string(seed) + "\n");
  file.write("scans: " + std::to_string(report.scans) + " at 10 Hz\npoints: " + std::to_string(report.points) + "\n");
  file.write("duration: " + std::to_string(report.duration) + " s\nlength: " + std::to_string(report.length) +
             " m\n\n");
  file.write(
      "velodyne_hits.bin, ms25.csv, gps.csv and groundtruth_2013-06-01.csv are laid out as NCLT has them (axes z "
      "down;\n"
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
  const TownDrive drive(preset, seed);
  SimulationReport report{
      .scans = drive.scan_count(), .duration = drive.drive().duration(), .length = drive.drive().length()};
  report.points = write_hits(folder.file("velodyne_hits.bin"), drive, run_chunks, progress);
  write_ms25(folder.file("ms25.csv"), drive);
  write_gps(folder.file("gps.csv"), drive);
  write_ground_truth(folder.file("groundtruth_2013-06-01.csv"), drive);
  write_tum(folder.file("truth.tum"), drive.truth_at_scan_ends());
  write_readme(folder.file("README.txt"), preset, seed, report);
  report.bytes = folder.keep();
  return report;
}

}  // namespace chainslam::simulator
